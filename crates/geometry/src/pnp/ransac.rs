//! The pose from correspondences of which many may be wrong.
//!
//! Samples of two (gravity known) or three correspondences give candidate poses, scored by truncated squared residuals.
//! A candidate that beats all before it is refined on its inliers in all six degrees of freedom, so that gravity
//! only guides the search: its error (about a degree) is allowed for when candidates are scored, and is gone after.
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

/// Error of the given gravity (radians) that candidates are allowed when they are scored: 1 degree.
const GRAVITY_TOLERANCE: f64 = 0.017_453_292_519_943_295;
/// The first candidates of a search are drawn in any case: not every sample of inliers gives a good pose.
const MIN_SAMPLES: usize = 20;
/// How many times more samples than the textbook number are drawn, for the same reason.
const SAMPLE_FACTOR: f64 = 3.0;
/// Rounds of refinement and of choosing the inliers again.
const REFIT_ROUNDS: usize = 6;
/// Iterations of each refinement.
const REFIT_ITERATIONS: usize = 10;
/// Huber's threshold of the refinements, in standard deviations of a pixel.
const HUBER_SIGMAS: f64 = 2.5;
/// The pose has six unknowns, so three points fit exactly and prove nothing.
const MIN_INLIERS: usize = 4;

/// How to search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RansacOptions {
    /// Residual (pixels) up to which a correspondence is an inlier.
    pub threshold_px: f64,
    /// Wanted probability that the search has drawn a sample of inliers, in (0, 1).
    pub confidence: f64,
    /// Largest number of samples.
    pub max_iterations: usize,
    /// Fewest inliers of a pose that is returned; never below 4.
    pub min_inliers: usize,
    /// Of the random samples: the same seed and input give the same pose.
    pub seed: u64,
    /// The direction of gravity in both frames, to about 1 degree. Samples are of two points with it, of three without.
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

/// A pose and what supports it.
#[derive(Clone, Debug, PartialEq)]
pub struct PnpSolution {
    /// The pose, refined on the inliers; its covariance takes the points for exact.
    pub world_from_camera: PoseWithCovariance,
    /// Indices of the inliers into the correspondences, rising.
    pub inliers: Vec<usize>,
    /// Mean length of the residuals of the inliers, pixels.
    pub mean_error_px: f64,
}

/// Finds the pose that most correspondences agree on, and refines it on them.
///
/// # Arguments
/// * `correspondences`: in any order, outliers among them. Points that fall behind the camera, and pixels without a ray,
///   are outliers.
/// * `sigma_px`: standard deviation of an inlier's pixel in u and in v.
///
/// # Returns
/// The pose with the covariance of [`refine`], and its inliers.
///
/// # Errors
/// [`PnpError::TooFew`] below `min_inliers` correspondences, [`PnpError::TooFewInliers`] where no pose has that many,
/// [`PnpError::InvalidInput`] on NaN or infinity and on options out of their range.
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

/// Where candidate poses come from.
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

/// A pose with the correspondences that agree with it.
struct Support {
    pose: Pose,
    /// Sum of the squared residuals, each cut off at the squared threshold.
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
        let rays: Vec<(usize, UnitVector3<f64>)> = self
            .correspondences
            .iter()
            .enumerate()
            .filter_map(|(i, correspondence)| Some((i, self.camera.bearing(&correspondence.pixel).ok()?)))
            .collect();
        let size = self.sampler.size();
        if rays.len() < size {
            return None;
        }
        let mut random = Xoshiro256PlusPlus::seed_from_u64(self.options.seed);
        let threshold = self.candidate_threshold();
        let mut best_candidate = f64::INFINITY;
        let mut best: Option<Support> = None;
        let mut wanted = self.options.max_iterations;
        let mut drawn = 0;
        while drawn < wanted {
            drawn += 1;
            let sample = draw_distinct(&mut random, rays.len(), size);
            for pose in self.candidates(&sample, &rays) {
                let score = self.score(&pose, threshold, best_candidate);
                if score >= best_candidate {
                    continue;
                }
                best_candidate = score;
                let optimized = self.optimize(&pose, threshold);
                if best.as_ref().is_none_or(|support| optimized.score < support.score) {
                    let inlier_ratio = optimized.inliers.len() as f64 / rays.len() as f64;
                    wanted = wanted.min(self.samples_needed(inlier_ratio));
                    best = Some(optimized);
                }
            }
        }
        best
    }

    /// Candidates from a gravity that is a little off are off by that angle.
    fn candidate_threshold(&self) -> f64 {
        match self.sampler {
            Sampler::ThreePoint => self.options.threshold_px,
            Sampler::TwoPoint { .. } => {
                let focal = 0.5 * (self.camera.focal[0] + self.camera.focal[1]);
                self.options.threshold_px + focal * GRAVITY_TOLERANCE
            }
        }
    }

    fn candidates(&self, sample: &[usize; 3], rays: &[(usize, UnitVector3<f64>)]) -> Vec<Pose> {
        let chosen = sample.map(|k| rays[k]);
        let points = chosen.map(|(i, _)| self.correspondences[i].point);
        let bearings = chosen.map(|(_, ray)| ray);
        let poses = match &self.sampler {
            Sampler::ThreePoint => p3p(&bearings, &points),
            Sampler::TwoPoint { in_world, in_camera } => {
                gravity_two_point(&[points[0], points[1]], &[bearings[0], bearings[1]], in_world, in_camera)
            }
        };
        poses.unwrap_or_default()
    }

    /// Truncated squared residuals; stops early above `enough`.
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

    /// Refines on the inliers, with a threshold that shrinks from that of a candidate to the strict one. Never worse, by
    /// the strict score, than the pose it was given.
    fn optimize(&self, pose: &Pose, candidate_threshold: f64) -> Support {
        let strict = self.options.threshold_px;
        let mut best = self.support(pose, strict);
        let mut current = self.support(pose, candidate_threshold);
        for round in 1..=REFIT_ROUNDS {
            let Ok(refined) = self.refit(&current) else { break };
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

    fn refit(&self, support: &Support) -> Result<PoseWithCovariance, PnpError> {
        let chosen: Vec<Correspondence> = support.inliers.iter().map(|&i| self.correspondences[i]).collect();
        refine(self.camera, &chosen, &support.pose, self.sigma_px, REFIT_ITERATIONS, Some(HUBER_SIGMAS))
    }

    fn samples_needed(&self, inlier_ratio: f64) -> usize {
        let good_sample = inlier_ratio.powi(self.sampler.size() as i32).clamp(1e-12, 1.0 - 1e-12);
        let textbook = (1.0 - self.options.confidence).ln() / (-good_sample).ln_1p();
        ((SAMPLE_FACTOR * textbook).ceil() as usize).max(MIN_SAMPLES)
    }

    /// The last refinement, on the final inliers.
    fn finish(&self, support: &Support, needed: usize) -> Result<PnpSolution, PnpError> {
        let world_from_camera = self.refit(support)?;
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

/// The first `size` (at most 3) of the returned numbers are distinct and below `count`; the others repeat the first.
fn draw_distinct(random: &mut Xoshiro256PlusPlus, count: usize, size: usize) -> [usize; 3] {
    let mut sample = [random.random_range(0..count); 3];
    for k in 1..size.min(count) {
        while sample[..k].contains(&sample[k]) {
            sample[k] = random.random_range(0..count);
        }
    }
    sample
}
