//! Outlier rejection: RANSAC on the epipolar geometry of two images.
//!
//! With the rotation from a gyroscope two points give the direction of translation: it is orthogonal to every
//! `(R f) x g`. Without it, a relative pose is fitted to five points, starting from a small motion. The best hypothesis
//! is refined on all inliers, rotation included, because gyroscopes have a bias.
//!
//! Sources: Fischler & Bolles, CACM 1981; Troiani et al., "2-point-based outlier rejection for camera-IMU systems",
//! ICRA 2014; the five-point step in [`super::relative_pose`].

use super::relative_pose::{BearingPair, RefinementOptions, RelativePose, rotation_between};
use geometry::Rotation;
use nalgebra::Vector3;

/// Settings of [`find_outliers`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OutlierOptions {
    /// Maximum angle between an inlier and its epipolar plane, radians.
    pub threshold: f64,
    /// Maximum number of hypotheses.
    pub max_hypotheses: usize,
    /// Seed of the random samples; the same seed and input give the same result.
    pub seed: u64,
}

impl Default for OutlierOptions {
    /// 1.2 px at a focal length of 460 px.
    fn default() -> Self {
        Self { threshold: 1.2 / 460.0, max_hypotheses: 100, seed: 7 }
    }
}

/// The result of [`find_outliers`].
#[derive(Clone, Debug, PartialEq)]
pub struct Consensus {
    /// For each pair whether it is an inlier.
    pub inliers: Vec<bool>,
    /// The relative pose with the most inliers.
    pub pose: RelativePose,
}

/// Probability of having drawn a sample without outliers at which sampling ends.
const CONFIDENCE: f64 = 0.999;
/// Minimum number of pairs: five unknowns and some redundancy.
const MIN_PAIRS: usize = 8;
/// Rounds of refinement and inlier selection.
const REFINEMENTS: usize = 4;

/// Separates inliers of one relative pose from outliers.
///
/// # Arguments
/// * `rotation`: `current_from_previous`, if known, and its standard deviation (radians), a prior of the refinement.
///
/// # Returns
/// `None` with fewer than eight pairs, or if no relative pose has five inliers.
pub fn find_outliers(
    pairs: &[BearingPair],
    rotation: Option<(&Rotation, f64)>,
    options: &OutlierOptions,
) -> Option<Consensus> {
    if pairs.len() < MIN_PAIRS {
        return None;
    }
    let mut search = Search { pairs, options, random: SplitMix(options.seed), best: None };
    match rotation {
        Some((rotation, _)) => search.known_rotation(rotation),
        None => search.unknown_rotation(),
    }
    let (mut pose, mut count) = search.best?;
    let sigma = rotation.map_or(f64::INFINITY, |(_, sigma)| sigma);
    let noise = options.threshold / 3.0;
    let refinement = RefinementOptions {
        scale: options.threshold,
        sigma_bearing_rad: noise,
        sigma_rotation_rad: sigma,
        iterations: 4,
    };
    for _ in 0..REFINEMENTS {
        let near = |pair: &&BearingPair| pose.residual(pair) < 2.0 * options.threshold;
        let fitting: Vec<BearingPair> = pairs.iter().filter(near).copied().collect();
        let Some(refined) = pose.refined(&fitting, &refinement) else { break };
        let refined_count = search.count(&refined);
        if refined_count < count {
            break;
        }
        (pose, count) = (refined, refined_count);
    }
    if count < 5 {
        return None;
    }
    Some(Consensus {
        inliers: pairs.iter().map(|pair| pose.residual(pair) < options.threshold).collect(),
        pose,
    })
}

struct Search<'a> {
    pairs: &'a [BearingPair],
    options: &'a OutlierOptions,
    random: SplitMix,
    best: Option<(RelativePose, usize)>,
}

impl Search<'_> {
    fn count(&self, pose: &RelativePose) -> usize {
        self.pairs.iter().filter(|pair| pose.residual(pair) < self.options.threshold).count()
    }

    fn consider(&mut self, pose: RelativePose) {
        let count = self.count(&pose);
        if self.best.is_none_or(|(_, best)| count > best) {
            self.best = Some((pose, count));
        }
    }

    /// Whether enough samples of `size` pairs have been drawn.
    fn is_enough(&self, drawn: usize, size: i32) -> bool {
        let inlier_ratio = self.best.map_or(0.0, |(_, count)| count as f64 / self.pairs.len() as f64);
        let failing = (1.0 - inlier_ratio.powi(size)).max(1e-12);
        drawn as f64 * failing.ln() < (1.0 - CONFIDENCE).ln()
    }

    fn known_rotation(&mut self, rotation: &Rotation) {
        let normals: Vec<Vector3<f64>> =
            self.pairs.iter().map(|pair| (rotation * pair.previous).cross(&pair.current)).collect();
        // Pure rotation is a hypothesis of its own: any direction of translation explains it.
        self.consider(RelativePose { current_from_previous: *rotation, direction: Vector3::z() });
        let mut drawn = 0;
        while drawn < self.options.max_hypotheses && !self.is_enough(drawn, 2) {
            drawn += 1;
            let [i, j] = self.random.distinct::<2>(self.pairs.len());
            let Some(direction) = normals[i].cross(&normals[j]).try_normalize(1e-12) else { continue };
            for direction in [direction, -direction] {
                self.consider(RelativePose { current_from_previous: *rotation, direction });
            }
        }
    }

    fn unknown_rotation(&mut self) {
        // The parallax of most points is below this many thresholds.
        let rotation = rotation_between(self.pairs, 10.0 * self.options.threshold, 10);
        self.consider(RelativePose { current_from_previous: rotation, direction: Vector3::z() });
        let refinement = RefinementOptions {
            scale: f64::INFINITY,
            sigma_bearing_rad: self.options.threshold / 3.0,
            sigma_rotation_rad: f64::INFINITY,
            iterations: 8,
        };
        let mut drawn = 0;
        while drawn < self.options.max_hypotheses && !self.is_enough(drawn, 5) {
            let direction = [Vector3::x(), Vector3::y(), Vector3::z()][drawn % 3];
            drawn += 1;
            let sample = self.random.distinct::<5>(self.pairs.len()).map(|index| self.pairs[index]);
            let start = RelativePose { current_from_previous: rotation, direction };
            let Some(pose) = start.refined(&sample, &refinement) else { continue };
            self.consider(pose);
            self.consider(RelativePose { direction: -pose.direction, ..pose });
        }
    }
}

/// A small deterministic random number generator.
///
/// Source: Steele, Lea & Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014.
struct SplitMix(u64);

impl SplitMix {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// `N` different numbers below `end`, which is at least `N`.
    fn distinct<const N: usize>(&mut self, end: usize) -> [usize; N] {
        let mut out = [usize::MAX; N];
        for k in 0..N {
            loop {
                let value = (self.next() % end as u64) as usize;
                if !out[..k].contains(&value) {
                    out[k] = value;
                    break;
                }
            }
        }
        out
    }
}
