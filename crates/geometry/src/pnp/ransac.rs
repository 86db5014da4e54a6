//! Robust pose estimation from correspondences with outliers: MSAC with local optimization.
//!
//! Samples of two (gravity known) or three correspondences give candidate poses, scored by truncated squared residuals.
//! The best candidate so far is refined on its inliers in all six degrees of freedom, so that gravity only guides the
//! sampling: its error (about a degree) widens the threshold for candidates and does not affect the result.
//!
//! Sources: Fischler & Bolles, CACM 1981; Torr & Zisserman, CVIU 2000 (MSAC); Chum, Matas & Kittler, DAGM 2003 (local
//! optimization).

use super::gravity::{Gravity, gravity_two_point};
use super::p3p::p3p;
use super::refine::refine;
use super::{Correspondence, PnpError};
use crate::camera::Camera;
use crate::pose::Pose;
use crate::uncertain_pose::PoseWithCovariance;
use nalgebra::UnitVector3;
use rand::rngs::Xoshiro256PlusPlus;
use rand::{RngExt, SeedableRng};

/// Tolerated error of the given gravity when candidates are scored, radians: 1 degree.
const GRAVITY_TOLERANCE: f64 = 0.017_453_292_519_943_295;
/// Minimum number of samples: not every sample of inliers gives a good pose.
const MIN_SAMPLES: usize = 20;
/// Factor on the theoretical number of samples, for the same reason.
const SAMPLE_FACTOR: f64 = 3.0;
/// Rounds of refinement and inlier selection.
const REFIT_ROUNDS: usize = 6;
/// Inliers that each of these refinements takes, evenly chosen from more: their pose is only scored. The last takes all.
const REFIT_POINTS: usize = 100;
/// Iterations of each refinement.
const REFIT_ITERATIONS: usize = 10;
/// Huber's threshold of the refinements, in standard deviations of a pixel.
const HUBER_SIGMAS: f64 = 2.5;
/// Minimum number of inliers: three points always fit the six unknowns exactly.
const MIN_INLIERS: usize = 4;

/// Settings of [`solve_ransac`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RansacOptions {
    /// Maximum residual of an inlier, pixels.
    pub threshold_px: f64,
    /// Probability of having drawn a sample of inliers, in (0, 1).
    pub confidence: f64,
    /// Maximum number of samples.
    pub max_iterations: usize,
    /// Minimum number of inliers; never below 4.
    pub min_inliers: usize,
    /// Seed of the random samples; the same seed and input give the same pose.
    pub seed: u64,
    /// The direction of gravity in both frames, to about 1 degree. Minimal samples have two points with it, three without.
    pub gravity: Option<Gravity>,
}

impl Default for RansacOptions {
    /// 4 px, 99.9 %, 1000 samples, 10 inliers, no gravity.
    fn default() -> Self {
        Self {
            threshold_px: 4.0,
            confidence: 0.999,
            max_iterations: 1000,
            min_inliers: 10,
            seed: 0,
            gravity: None,
        }
    }
}

/// A pose and its inliers.
#[derive(Clone, Debug, PartialEq)]
pub struct PnpSolution {
    /// The pose, refined on the inliers; its covariance assumes exact points.
    pub world_from_camera: PoseWithCovariance,
    /// Indices of the inliers, ascending.
    pub inliers: Vec<usize>,
    /// Mean norm of the residuals of the inliers, pixels.
    pub mean_error_px: f64,
}

/// Estimates `world_from_camera` robustly and refines it on the inliers.
///
/// # Arguments
/// * `correspondences`: in any order, with outliers. Points behind the camera and pixels that cannot be unprojected are
///   outliers.
/// * `sigma_px`: standard deviation of an inlier pixel in u and in v.
///
/// # Returns
/// The pose with the covariance of [`refine`], and its inliers.
///
/// # Errors
/// [`PnpError::TooFew`] below `min_inliers` correspondences, [`PnpError::TooFewInliers`] if no pose has that many,
/// [`PnpError::InvalidInput`] on NaN or infinity and on options out of range.
///
/// # Example
/// ```
/// use geometry::pnp::{Correspondence, RansacOptions, solve_ransac};
/// use geometry::{Camera, Distortion, Pose, rotation};
/// use nalgebra::{Vector2, Vector3};
///
/// let camera =
///     Camera { width: 752, height: 480, focal: [460.0; 2], centre: [376.0, 240.0], distortion: Distortion::None };
/// let truth = Pose::new(rotation::exp(&Vector3::new(0.1, -0.2, 0.3)), Vector3::new(1.0, 2.0, 0.5));
/// let mut correspondences: Vec<Correspondence> = (0..40)
///     .map(|k| {
///         let k = f64::from(k);
///         let in_camera = Vector3::new((1.7 * k).sin(), (2.3 * k).cos(), 5.0 + (0.9 * k).sin());
///         let pixel = camera.project(&in_camera).unwrap();
///         Correspondence { point: truth.transform(&in_camera), pixel }
///     })
///     .collect();
/// for outlier in &mut correspondences[..12] {
///     outlier.pixel += Vector2::new(60.0, -45.0);
/// }
/// let found = solve_ransac(&camera, &correspondences, &RansacOptions::default(), 1.0)?;
/// assert_eq!(found.inliers, (12..40).collect::<Vec<_>>());
/// assert!(found.world_from_camera.pose.local(&truth).norm() < 1e-6);
/// # Ok::<(), geometry::PnpError>(())
/// ```
pub fn solve_ransac(
    camera: &Camera,
    correspondences: &[Correspondence],
    options: &RansacOptions,
    sigma_px: f64,
) -> Result<PnpSolution, PnpError> {
    check_options(options, sigma_px)?;
    if !correspondences.iter().all(Correspondence::is_finite) {
        return Err(PnpError::InvalidInput);
    }
    let needed = options.min_inliers.max(MIN_INLIERS);
    if correspondences.len() < needed {
        return Err(PnpError::TooFew { given: correspondences.len(), needed });
    }
    let sampler = match &options.gravity {
        Some(gravity) => {
            let (in_world, in_camera) = gravity.directions().ok_or(PnpError::InvalidInput)?;
            Sampler::TwoPoint { in_world, in_camera }
        }
        None => Sampler::ThreePoint,
    };
    let search = Search { camera, correspondences, options, sigma_px, sampler };
    let best = search.run();
    let found = best.as_ref().map_or(0, |support| support.inliers.len());
    let Some(support) = best.filter(|support| support.inliers.len() >= needed) else {
        return Err(PnpError::TooFewInliers { found, needed });
    };
    search.finish(&support, needed)
}

fn check_options(options: &RansacOptions, sigma_px: f64) -> Result<(), PnpError> {
    let valid = options.threshold_px.is_finite()
        && options.threshold_px > 0.0
        && options.confidence > 0.0
        && options.confidence < 1.0
        && sigma_px.is_finite()
        && sigma_px > 0.0;
    if valid { Ok(()) } else { Err(PnpError::InvalidInput) }
}

/// The minimal solver.
enum Sampler {
    TwoPoint { in_world: UnitVector3<f64>, in_camera: UnitVector3<f64> },
    ThreePoint,
}

impl Sampler {
    fn size(&self) -> usize {
        match self {
            Self::TwoPoint { .. } => 2,
            Self::ThreePoint => 3,
        }
    }
}

/// A pose with its inliers.
struct Support {
    pose: Pose,
    /// Sum of the squared residuals, truncated at the squared threshold.
    score: f64,
    inliers: Vec<usize>,
}

struct Search<'a> {
    camera: &'a Camera,
    correspondences: &'a [Correspondence],
    options: &'a RansacOptions,
    sigma_px: f64,
    sampler: Sampler,
}

impl Search<'_> {
    /// The best locally optimized pose.
    fn run(&self) -> Option<Support> {
        let count = self.correspondences.len();
        let size = self.sampler.size();
        let mut random = Xoshiro256PlusPlus::seed_from_u64(self.options.seed);
        let threshold = self.candidate_threshold();
        let mut best_candidate = f64::INFINITY;
        let mut best: Option<Support> = None;
        let mut wanted = self.options.max_iterations;
        let mut drawn = 0;
        while drawn < wanted {
            drawn += 1;
            let sample = draw_distinct(&mut random, count, size);
            for pose in self.candidates(&sample) {
                let score = self.score(&pose, threshold, best_candidate);
                if score >= best_candidate {
                    continue;
                }
                best_candidate = score;
                let optimized = self.optimize(&pose, threshold);
                if best.as_ref().is_none_or(|support| optimized.score < support.score) {
                    let inlier_ratio = optimized.inliers.len() as f64 / count as f64;
                    wanted = wanted.min(self.samples_needed(inlier_ratio));
                    best = Some(optimized);
                }
            }
        }
        best
    }

    /// Threshold for candidates, which includes the error of the gravity.
    fn candidate_threshold(&self) -> f64 {
        match self.sampler {
            Sampler::ThreePoint => self.options.threshold_px,
            Sampler::TwoPoint { .. } => {
                let focal = 0.5 * (self.camera.focal[0] + self.camera.focal[1]);
                self.options.threshold_px + focal * GRAVITY_TOLERANCE
            }
        }
    }

    /// The poses that explain a sample, none where one of its pixels cannot be unprojected.
    fn candidates(&self, sample: &[usize; 3]) -> Vec<Pose> {
        let chosen = sample.map(|at| &self.correspondences[at]);
        let [Ok(first), Ok(second), Ok(third)] = chosen.map(|chosen| self.camera.bearing(&chosen.pixel))
        else {
            return Vec::new();
        };
        let (points, bearings) = (chosen.map(|chosen| chosen.point), [first, second, third]);
        let poses = match &self.sampler {
            Sampler::ThreePoint => p3p(&bearings, &points),
            Sampler::TwoPoint { in_world, in_camera } => {
                gravity_two_point(&[points[0], points[1]], &[bearings[0], bearings[1]], in_world, in_camera)
            }
        };
        poses.unwrap_or_default()
    }

    /// Sum of truncated squared residuals; stops early above `enough`.
    fn score(&self, pose: &Pose, threshold: f64, enough: f64) -> f64 {
        let limit = threshold * threshold;
        let mut sum = 0.0;
        for correspondence in self.correspondences {
            sum += correspondence
                .reprojection_error(self.camera, pose)
                .map_or(limit, |error| limit.min(error * error));
            if sum >= enough {
                break;
            }
        }
        sum
    }

    fn support(&self, pose: &Pose, threshold: f64) -> Support {
        let limit = threshold * threshold;
        let mut support = Support { pose: *pose, score: 0.0, inliers: Vec::new() };
        for (i, correspondence) in self.correspondences.iter().enumerate() {
            match correspondence.reprojection_error(self.camera, pose) {
                Some(error) if error <= threshold => {
                    support.score += error * error;
                    support.inliers.push(i);
                }
                _ => support.score += limit,
            }
        }
        support
    }

    /// Local optimization: refines on the inliers with a threshold that decreases from that of a candidate to the strict
    /// one. Never worse by the strict score than the given pose.
    fn optimize(&self, pose: &Pose, candidate_threshold: f64) -> Support {
        let strict = self.options.threshold_px;
        let mut best = self.support(pose, strict);
        let mut current = self.support(pose, candidate_threshold);
        for round in 1..=REFIT_ROUNDS {
            let Ok(refined) = self.refit(&current, REFIT_POINTS) else { break };
            let strict_support = self.support(&refined.pose, strict);
            let improved = strict_support.score < best.score;
            let threshold = strict + (candidate_threshold - strict) * 0.5_f64.powi(round as i32 + 1);
            let shrinking = threshold > 1.1 * strict;
            current = if shrinking {
                self.support(&refined.pose, threshold)
            } else {
                self.support(&refined.pose, strict)
            };
            if improved {
                best = strict_support;
            } else if !shrinking {
                break;
            }
        }
        best
    }

    /// Refines a pose on at most so many of its inliers.
    fn refit(&self, support: &Support, at_most: usize) -> Result<PoseWithCovariance, PnpError> {
        let step = support.inliers.len().div_ceil(at_most).max(1);
        let chosen = support.inliers.iter().step_by(step).map(|&at| self.correspondences[at]);
        let chosen: Vec<Correspondence> = chosen.collect();
        refine(self.camera, &chosen, &support.pose, self.sigma_px, REFIT_ITERATIONS, Some(HUBER_SIGMAS))
    }

    fn samples_needed(&self, inlier_ratio: f64) -> usize {
        let good_sample = inlier_ratio.powi(self.sampler.size() as i32).clamp(1e-12, 1.0 - 1e-12);
        let textbook = (1.0 - self.options.confidence).ln() / (-good_sample).ln_1p();
        ((SAMPLE_FACTOR * textbook).ceil() as usize).max(MIN_SAMPLES)
    }

    /// Final refinement on the final inliers.
    fn finish(&self, support: &Support, needed: usize) -> Result<PnpSolution, PnpError> {
        let world_from_camera = self.refit(support, usize::MAX)?;
        let last = self.support(&world_from_camera.pose, self.options.threshold_px);
        let found = last.inliers.len();
        if found < needed {
            return Err(PnpError::TooFewInliers { found, needed });
        }
        let errors = last.inliers.iter().filter_map(|&i| {
            self.correspondences[i].reprojection_error(self.camera, &world_from_camera.pose)
        });
        let mean_error_px = errors.sum::<f64>() / found as f64;
        Ok(PnpSolution { world_from_camera, inliers: last.inliers, mean_error_px })
    }
}

/// Draws `size` (at most 3) distinct indices below `count`; the remaining elements repeat the first.
fn draw_distinct(random: &mut Xoshiro256PlusPlus, count: usize, size: usize) -> [usize; 3] {
    let mut sample = [random.random_range(0..count); 3];
    for k in 1..size.min(count) {
        while sample[..k].contains(&sample[k]) {
            sample[k] = random.random_range(0..count);
        }
    }
    sample
}
