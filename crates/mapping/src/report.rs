//! Statistics of a built map.

use std::collections::BTreeMap;

use protocol::KeyframeId;
use sensors::Frame;
use serde::Serialize;

use super::keyframe_view::{KeyframeView, image_count};

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

/// Images in which next to nothing was tracked: dark or covered ones; of a rig, instants at which no camera tracked anything.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct UntrackedImages {
    /// Their number.
    pub images: usize,
    /// Number of all images.
    pub of: usize,
    /// Longest stretch of them, which the IMU alone bridges (s).
    pub longest_s: f64,
}

impl UntrackedImages {
    /// Fewest tracks of an image that bind it to those before and after it.
    const FEWEST_TRACKS: usize = 8;

    /// Those of a recording; `None` where there are none, or no image has tracks.
    pub(super) fn of(frames: &[Frame]) -> Option<UntrackedImages> {
        let is_tracked = |frame: &Frame| {
            let mut counts: BTreeMap<u8, usize> = BTreeMap::new();
            frame.tracks.iter().for_each(|track| *counts.entry(track.camera).or_default() += 1);
            counts.values().any(|&count| count >= Self::FEWEST_TRACKS)
        };
        let mut last_tracked = frames.iter().find(|frame| is_tracked(frame))?.stamp_ns;
        let (mut images, mut longest_ns) = (0, 0);
        for frame in frames {
            if is_tracked(frame) {
                last_tracked = frame.stamp_ns;
            } else {
                images += 1;
                longest_ns = longest_ns.max(frame.stamp_ns - last_tracked);
            }
        }
        let longest_s = longest_ns as f64 * 1e-9;
        (images > 0).then_some(UntrackedImages { images, of: frames.len(), longest_s })
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
    /// Images in which next to nothing was tracked; for a map from reference poses it is not looked at.
    pub untracked_images: Option<UntrackedImages>,
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
    /// Standard deviation of the scale of the stated positions (1); `None` where they determine none.
    pub sigma_scale: Option<f64>,
    /// Standard deviation of the first keyframe's tilt against gravity, an axis (deg); `None` where gravity is not known.
    pub sigma_tilt_deg: Option<f64>,
    /// Pairs of keyframes with a stated cross-covariance: in large maps all are correlated, and the nearer ones have a block.
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
            keyframes: image_count(views),
            stereo_features: views.iter().map(KeyframeView::stereo_count).sum(),
            unreadable_images,
            ..BuildReport::default()
        }
    }

    /// A keyframe with fewer landmarks than this does not localize a robot: PnP needs 8 inliers.
    pub const FEW_LANDMARKS: usize = 10;
}

#[cfg(test)]
mod tests {
    use super::*;
    use estimator::TrackObservation;
    use nalgebra::Vector2;

    #[test]
    fn the_longest_stretch_without_tracks_is_found() {
        let frame = |k: i64, tracks: u64| Frame {
            stamp_ns: k * 500_000_000,
            tracks: (0..tracks)
                .map(|feature_id| TrackObservation { camera: 0, feature_id, pixel: Vector2::zeros() })
                .collect(),
            ..Frame::default()
        };
        let recording = |dark: &[i64]| -> Vec<Frame> {
            (0..10).map(|k| frame(k, if dark.contains(&k) { 3 } else { 50 })).collect()
        };
        assert_eq!(UntrackedImages::of(&recording(&[])), None);
        let found = UntrackedImages::of(&recording(&[0, 3, 4, 5, 8])).unwrap();
        assert_eq!(found, UntrackedImages { images: 5, of: 10, longest_s: 1.5 });
        let all: Vec<i64> = (0..10).collect();
        assert_eq!(UntrackedImages::of(&recording(&all)), None, "features only");
    }
}
