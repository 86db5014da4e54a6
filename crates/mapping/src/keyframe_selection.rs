//! Keyframe selection: which images become keyframes.

use geometry::camera::Camera;
use geometry::uncertain_pose::PoseWithCovariance;
use nalgebra::{Matrix6, Vector2};
use protocol::FeatureSet;
use sensors::{Frame, ReferencePose, Sequence};
use vision::{DescriptorError, MatchOptions, match_descriptors};

use super::error::BuildError;
use super::feature_source::{FeatureSource, FrameFeatures};
use super::keyframe_view::{KeyframeView, descriptors};
use super::options::BuildOptions;
use super::progress::{Progress, Stage};
use super::reference_poses::ReferencePoses;

/// Part of the thresholds of motion from which on features are extracted and compared with the last keyframe: images
/// before are skipped, since extraction is expensive.
const EXTRACTION_THRESHOLD: f64 = 0.5;
/// The next comparison is after this much more motion.
const EXTRACTION_STEP: f64 = 0.25;

/// Selects keyframes: images with a pose, when the camera has moved enough since the last keyframe, or when too few of its
/// features are matched.
pub(super) fn select_keyframes<'a>(
    sequence: &'a Sequence,
    references: &[ReferencePose],
    source: &mut FeatureSource<'_, '_>,
    options: &BuildOptions,
    progress: Progress<'_>,
) -> Result<Vec<KeyframeView<'a>>, BuildError> {
    let (Some(sensor), Some(first)) = (sequence.cameras.first(), sequence.frames.first()) else {
        return Err(source.no_features(sequence));
    };
    let candidates: Vec<&Frame> = sequence.frames.iter().filter(|frame| source.has_features(frame)).collect();
    if candidates.is_empty() {
        return Err(source.no_features(sequence));
    }
    let poses = ReferencePoses::new(references);
    let seconds = |stamp_ns: i64| (stamp_ns - first.stamp_ns) as f64 * 1e-9;
    let in_time = |frame: &&&Frame| (options.from_s..=options.until_s).contains(&seconds(frame.stamp_ns));
    let mut views: Vec<KeyframeView<'a>> = Vec::new();
    let mut next_comparison = EXTRACTION_THRESHOLD;
    for (done, frame) in candidates.iter().enumerate().filter(|(_, frame)| in_time(frame)) {
        progress(Stage::KeyframeSelection, done, candidates.len());
        let Some(reference) = poses.at(frame.stamp_ns) else { continue };
        let prior = camera_pose(&reference, &sensor.imu_from_camera, options);
        let change = views.last().map_or(f64::INFINITY, |last| relative_motion(&last.prior, &prior, options));
        if change < next_comparison.min(1.0) {
            continue;
        }
        if let Some(last) = views.last().filter(|_| change < 1.0) {
            next_comparison = change + EXTRACTION_STEP;
            let Some(features) = source.features_of(frame)? else { continue };
            if overlap(last, &features)? >= options.min_overlap {
                continue;
            }
        }
        let Some(FrameFeatures { features, stereo }) = source.stereo_features_of(frame)? else { continue };
        if !features.is_empty() {
            next_comparison = EXTRACTION_THRESHOLD;
            let rays = rays(&sensor.camera, &features);
            views.push(KeyframeView {
                stamp_ns: frame.stamp_ns,
                features,
                tracked: Vec::new(),
                stereo,
                rays,
                prior,
            });
        }
    }
    progress(Stage::KeyframeSelection, candidates.len(), candidates.len());
    if views.is_empty() {
        return Err(BuildError::NoCommonStamps {
            images: candidates.len(),
            poses: references.len(),
            in_time: candidates.iter().filter(|frame| in_time(frame)).count(),
        });
    }
    Ok(views)
}

/// How far a camera has moved or rotated, as a part of the thresholds of a new keyframe.
fn relative_motion(last: &PoseWithCovariance, now: &PoseWithCovariance, options: &BuildOptions) -> f64 {
    let distance = (last.pose.translation - now.pose.translation).norm();
    let angle = last.pose.rotation.angle_to(&now.pose.rotation);
    (distance / options.min_distance).max(angle / options.min_rotation)
}

/// The part of a keyframe's features that are matched in another image.
fn overlap(last: &KeyframeView<'_>, features: &FeatureSet) -> Result<f64, DescriptorError> {
    let (known, seen) = (last.descriptors()?, descriptors(features)?);
    let found = match_descriptors(known, seen, &MatchOptions::for_metric(known.metric()))?;
    Ok(found.len() as f64 / known.len().min(seen.len()).max(1) as f64)
}

/// The camera's pose and covariance from the IMU's: through the lever arm rotation errors cause position errors.
pub(super) fn camera_pose(
    reference: &ReferencePose,
    imu_from_camera: &geometry::pose::Pose,
    options: &BuildOptions,
) -> PoseWithCovariance {
    let covariance = stated_covariance(&reference.covariance, options);
    PoseWithCovariance::new(reference.pose, covariance).change_of_child(imu_from_camera)
}

/// The covariance of a reference pose; a sigma of the options replaces its block, and what that block was correlated with.
pub(super) fn stated_covariance(of_pose: &Matrix6<f64>, options: &BuildOptions) -> Matrix6<f64> {
    let mut covariance = *of_pose;
    for (first, sigma) in [(0, options.sigma_theta_rad), (3, options.sigma_p_m)] {
        let Some(sigma) = sigma else { continue };
        covariance.fixed_rows_mut::<3>(first).fill(0.0);
        covariance.fixed_columns_mut::<3>(first).fill(0.0);
        covariance.fixed_view_mut::<3, 3>(first, first).fill_diagonal(sigma * sigma);
    }
    covariance
}

pub(super) fn rays(camera: &Camera, features: &FeatureSet) -> Vec<Option<Vector2<f64>>> {
    let ray = |&[u, v]: &[f32; 2]| {
        let pixel = Vector2::new(f64::from(u), f64::from(v));
        camera.contains(&pixel).then(|| camera.unproject(&pixel).ok()).flatten()
    };
    features.pixels.iter().map(ray).collect()
}
