//! What was built, in numbers for people and programs.

use protocol::KeyframeId;
use serde::Serialize;

/// Mean, median and 95th percentile.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Spread {
    /// Arithmetic mean.
    pub mean: f64,
    /// Half of the values are smaller.
    pub median: f64,
    /// 95 % of the values are smaller.
    pub p95: f64,
}

impl Spread {
    /// The spread of some values; zeros without any.
    pub fn of(values: impl IntoIterator<Item = f64>) -> Spread {
        let mut values: Vec<f64> = values.into_iter().collect();
        if values.is_empty() {
            return Spread::default();
        }
        values.sort_by(f64::total_cmp);
        let at = |part: f64| values[((values.len() - 1) as f64 * part).round() as usize];
        Spread { mean: values.iter().sum::<f64>() / values.len() as f64, median: at(0.5), p95: at(0.95) }
    }

    /// The spread of the values times a factor.
    pub(super) fn scaled(self, factor: f64) -> Spread {
        Spread { mean: self.mean * factor, median: self.median * factor, p95: self.p95 * factor }
    }
}

/// What [`super::build_map`] did.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct BuildReport {
    /// Number of keyframes.
    pub keyframes: usize,
    /// Number of landmarks.
    pub landmarks: usize,
    /// Number of observations over all landmarks.
    pub observations: usize,
    /// Pairs of keyframes that were matched.
    pub pairs: usize,
    /// Matches that kept the epipolar constraint.
    pub matches: usize,
    /// Observations that were dropped because they fit no place of their landmark.
    pub dropped_observations: usize,
    /// Features that the stereo partner saw too.
    pub stereo_features: usize,
    /// Images that could not be read and were left out, with the reason.
    pub unreadable_images: Vec<String>,
    /// Standard deviation of a pixel, as given or as measured (px).
    pub sigma_px: f64,
    /// How many landmarks have 1, 2, 3 ... observations.
    pub track_lengths: Vec<usize>,
    /// Landmarks that a keyframe sees.
    pub landmarks_per_keyframe: Spread,
    /// Distance of an observation from its landmark with the poses refined (px): what the images leave.
    pub reprojection_px: Spread,
    /// The same with the given poses (px): what these add.
    pub reprojection_through_given_px: Spread,
    /// Standard deviation of the stated rotations (deg, root of the sum over three axes).
    pub sigma_pose_deg: Spread,
    /// Standard deviation of the stated positions (m, root of the sum over three axes).
    pub sigma_pose_m: Spread,
    /// Pairs of keyframes whose errors are stated to depend on each other.
    pub cross_covariances: usize,
    /// How far the refinement turned the poses (deg).
    pub pose_correction_deg: Spread,
    /// How far it moved them (m).
    pub pose_correction_m: Spread,
    /// Keyframes with fewer than [`BuildReport::FEW_LANDMARKS`] landmarks: a robot will hardly localize by these.
    pub poor_keyframes: Vec<KeyframeId>,
    /// Time taken (s).
    pub seconds: f64,
}

impl BuildReport {
    /// Fewer landmarks than this make a keyframe useless to a robot: PnP needs some left after outliers.
    pub const FEW_LANDMARKS: usize = 10;
}
