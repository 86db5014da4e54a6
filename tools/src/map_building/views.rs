//! Which images become keyframes, and what is known of each before any matching.

use std::collections::HashMap;

use geometry::camera::Camera;
use geometry::uncertain_pose::PoseWithCovariance;
use nalgebra::{Vector2, Vector3};
use onboard::sequence::{ReferencePose, Sequence};
use protocol::FeatureSet;

use super::options::{BuildError, BuildOptions};
use crate::map_files::isotropic_covariance;

/// An image that becomes a keyframe.
pub(super) struct View<'a> {
    /// When it was taken (ns).
    pub(super) stamp_ns: i64,
    /// What an extractor saw in it.
    pub(super) features: &'a FeatureSet,
    /// Normalized coordinates of each feature, `None` where the lens has no ray for the pixel.
    pub(super) rays: Vec<Option<Vector2<f64>>>,
    /// The given pose of the camera, with its covariance.
    pub(super) prior: PoseWithCovariance,
}

impl View<'_> {
    /// Pixel of a feature.
    pub(super) fn pixel(&self, feature: usize) -> Vector2<f64> {
        let [u, v] = self.features.pixels[feature];
        Vector2::new(f64::from(u), f64::from(v))
    }

    /// Where the camera looks, in G.
    pub(super) fn axis(&self) -> Vector3<f64> {
        self.prior.pose.rotation * Vector3::z()
    }
}

/// Selects keyframes: images with features and a pose of the same time stamp, as soon as the view has changed enough
/// since the last one. No pose is interpolated.
pub(super) fn select_views<'a>(
    sequence: &'a Sequence,
    references: &[ReferencePose],
    options: &BuildOptions,
) -> Result<Vec<View<'a>>, BuildError> {
    let name = || sequence.root.display().to_string();
    let (Some(sensor), Some(first)) = (sequence.cameras.first(), sequence.frames.first()) else {
        return Err(BuildError::NoFeatures { sequence: name() });
    };
    let with_features: Vec<(i64, &FeatureSet)> = sequence
        .frames
        .iter()
        .filter_map(|frame| Some((frame.stamp_ns, frame.features.as_ref()?)))
        .filter(|(_, features)| !features.pixels.is_empty())
        .collect();
    if with_features.is_empty() {
        return Err(BuildError::NoFeatures { sequence: name() });
    }
    let poses: HashMap<i64, &ReferencePose> = references.iter().map(|pose| (pose.stamp_ns, pose)).collect();
    let seconds = |stamp_ns: i64| (stamp_ns - first.stamp_ns) as f64 * 1e-9;
    let in_time = |stamp_ns: i64| (options.from_s..=options.until_s).contains(&seconds(stamp_ns));
    let mut views: Vec<View<'a>> = Vec::new();
    for &(stamp_ns, features) in with_features.iter().filter(|(stamp_ns, _)| in_time(*stamp_ns)) {
        let Some(reference) = poses.get(&stamp_ns) else { continue };
        let prior = camera_pose(reference, &sensor.imu_from_camera, options);
        let changed = views.last().is_none_or(|last| {
            (last.prior.pose.translation - prior.pose.translation).norm() >= options.min_distance
                || last.prior.pose.rotation.angle_to(&prior.pose.rotation) >= options.min_rotation
        });
        if changed {
            views.push(View { stamp_ns, features, rays: rays(&sensor.camera, features), prior });
        }
    }
    if views.is_empty() {
        return Err(BuildError::NoCommonStamps {
            features: with_features.len(),
            poses: references.len(),
            in_time: with_features.iter().filter(|(stamp_ns, _)| in_time(*stamp_ns)).count(),
        });
    }
    Ok(views)
}

/// The camera's pose and covariance from the IMU's: the lever arm turns rotation errors into position errors.
fn camera_pose(
    reference: &ReferencePose,
    imu_from_camera: &geometry::pose::Pose,
    options: &BuildOptions,
) -> PoseWithCovariance {
    let covariance = isotropic_covariance(
        options.sigma_theta.unwrap_or(reference.sigma_theta),
        options.sigma_p.unwrap_or(reference.sigma_p),
    );
    PoseWithCovariance::new(reference.pose, covariance).change_of_child(imu_from_camera)
}

fn rays(camera: &Camera, features: &FeatureSet) -> Vec<Option<Vector2<f64>>> {
    let ray = |&[u, v]: &[f32; 2]| {
        let pixel = Vector2::new(f64::from(u), f64::from(v));
        camera.contains(&pixel).then(|| camera.unproject(&pixel).ok()).flatten()
    };
    features.pixels.iter().map(ray).collect()
}
