//! Statistics of a built map.

use protocol::KeyframeId;
use serde::Serialize;

use super::keyframe_view::KeyframeView;

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
}

/// Statistics of a run of [`super::build_map`].
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct BuildReport {
    /// Number of keyframes.
    pub keyframes: usize,
    /// Number of landmarks.
    pub landmarks: usize,
    /// Number of observations over all landmarks.
    pub observations: usize,
    /// Pairs of keyframes that were matched.
    pub pairs: usize,
    /// Matches that satisfy the epipolar constraint.
    pub matches: usize,
    /// Loops that place recognition found; zero for a map from reference poses.
    pub loops: usize,
    /// Those of them that contradict the trajectory.
    pub refused_loops: usize,
    /// Poses and positions that were given as priors.
    pub pose_priors: usize,
    /// Those of them that lie outside the recording.
    pub pose_priors_outside: usize,
    /// Those of them that contradict the recording and the others.
    pub refused_pose_priors: usize,
    /// Factor on the stated noise of the IMU by which its readings fit the images; zero for a map from reference poses.
    pub imu_noise_scale: f64,
    /// Observations that were dropped as outliers.
    pub dropped_observations: usize,
    /// Features that were matched in the second camera.
    pub stereo_features: usize,
    /// Images that could not be read and were left out, with the reason.
    pub unreadable_images: Vec<String>,
    /// Standard deviation of a pixel, as given or as estimated (px).
    pub sigma_px: f64,
    /// How many landmarks have 1, 2, 3 ... observations.
    pub track_lengths: Vec<usize>,
    /// Landmarks per keyframe.
    pub landmarks_per_keyframe: Spread,
    /// Reprojection errors with the refined poses (px).
    pub reprojection_px: Spread,
    /// Reprojection errors with the reference poses (px).
    pub reprojection_through_given_px: Spread,
    /// Standard deviation of the stated rotations per axis (deg, root mean square over the three).
    pub sigma_pose_deg: Spread,
    /// Standard deviation of the stated positions per axis (m, root mean square over the three).
    pub sigma_pose_m: Spread,
    /// Standard deviation of the scale of the stated positions (1); `None` where a map is too large to state all correlations.
    pub sigma_scale: Option<f64>,
    /// Standard deviation of the first keyframe's tilt against gravity, an axis (deg); `None` where gravity is not known.
    pub sigma_tilt_deg: Option<f64>,
    /// Pairs of keyframes with a cross-covariance.
    pub cross_covariances: usize,
    /// Rotation between reference and refined poses (deg).
    pub pose_correction_deg: Spread,
    /// Distance between reference and refined positions (m).
    pub pose_correction_m: Spread,
    /// Keyframes with fewer than [`BuildReport::FEW_LANDMARKS`] landmarks: too few to localize by.
    pub poor_keyframes: Vec<KeyframeId>,
    /// Time taken (s).
    pub seconds: f64,
}

impl BuildReport {
    /// The statistics of the selected views.
    pub(super) fn of_views(views: &[KeyframeView<'_>], unreadable_images: Vec<String>) -> BuildReport {
        BuildReport {
            keyframes: views.iter().filter(|view| view.is_keyframe()).count(),
            stereo_features: views.iter().map(KeyframeView::stereo_count).sum(),
            unreadable_images,
            ..BuildReport::default()
        }
    }

    /// A keyframe with fewer landmarks than this does not localize a robot: PnP needs 8 inliers.
    pub const FEW_LANDMARKS: usize = 10;
}
