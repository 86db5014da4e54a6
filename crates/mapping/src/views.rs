//! Which images become keyframes, and what is known of each before any matching.

use std::borrow::Cow;

use geometry::camera::Camera;
use geometry::uncertain_pose::PoseWithCovariance;
use nalgebra::{Vector2, Vector3};
use protocol::FeatureSet;
use sensors::metric_of;
use sensors::{Frame, ReferencePose, Sequence};
use vision::{DescriptorError, DescriptorView, MatchOptions, match_descriptors};

use super::images::{FeatureSource, Seen};
use super::options::{BuildError, BuildOptions, Progress, Stage};
use super::references::References;
use map::text::isotropic_covariance;

/// Part of the thresholds of a view change from which on an image is compared with the last keyframe.
const LOOKED_AT: f64 = 0.5;

/// An image that becomes a keyframe.
pub(super) struct View<'a> {
    /// When it was taken (ns).
    pub(super) stamp_ns: i64,
    /// What an extractor saw in it.
    pub(super) features: Cow<'a, FeatureSet>,
    /// Pixel of each feature in the stereo partner's image, where it was found there.
    stereo: Vec<Option<Vector2<f64>>>,
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

    /// Pixel of a feature in the image of the stereo partner.
    pub(super) fn stereo_pixel(&self, feature: usize) -> Option<Vector2<f64>> {
        self.stereo.get(feature).copied().flatten()
    }

    /// Number of features that the stereo partner saw too.
    pub(super) fn stereo_count(&self) -> usize {
        self.stereo.iter().flatten().count()
    }

    /// The descriptors of all features.
    pub(super) fn descriptors(&self) -> Result<DescriptorView<'_>, DescriptorError> {
        descriptors(&self.features)
    }

    /// Where the camera looks, in G.
    pub(super) fn axis(&self) -> Vector3<f64> {
        self.prior.pose.rotation * Vector3::z()
    }
}

fn descriptors(features: &FeatureSet) -> Result<DescriptorView<'_>, DescriptorError> {
    let descriptors = &features.descriptors;
    DescriptorView::new(metric_of(descriptors.kind), usize::from(descriptors.width), &descriptors.bytes)
}

/// Selects keyframes: images with a pose, as soon as the view has changed enough since the last one, or shows too
/// little of what that one showed.
pub(super) fn select_views<'a>(
    sequence: &'a Sequence,
    references: &[ReferencePose],
    source: &mut FeatureSource<'_, '_>,
    options: &BuildOptions,
    progress: Progress<'_>,
) -> Result<Vec<View<'a>>, BuildError> {
    let (Some(sensor), Some(first)) = (sequence.cameras.first(), sequence.frames.first()) else {
        return Err(source.no_features(sequence));
    };
    let candidates: Vec<&Frame> = sequence.frames.iter().filter(|frame| source.can_see(frame)).collect();
    if candidates.is_empty() {
        return Err(source.no_features(sequence));
    }
    let poses = References::new(references);
    let seconds = |stamp_ns: i64| (stamp_ns - first.stamp_ns) as f64 * 1e-9;
    let in_time = |frame: &&&Frame| (options.from_s..=options.until_s).contains(&seconds(frame.stamp_ns));
    let mut views: Vec<View<'a>> = Vec::new();
    for (done, frame) in candidates.iter().enumerate().filter(|(_, frame)| in_time(frame)) {
        progress(Stage::Seeing, done, candidates.len());
        let Some(reference) = poses.at(frame.stamp_ns) else { continue };
        let prior = camera_pose(&reference, &sensor.imu_from_camera, options);
        let change = views.last().map_or(f64::INFINITY, |last| view_change(&last.prior, &prior, options));
        if change < LOOKED_AT {
            continue;
        }
        let Some(Seen { features, stereo }) = source.look(frame)? else { continue };
        let is_new = change >= 1.0
            || views
                .last()
                .is_some_and(|last| overlap(last, &features).is_ok_and(|part| part < options.min_overlap));
        if is_new && !features.is_empty() {
            let rays = rays(&sensor.camera, &features);
            views.push(View { stamp_ns: frame.stamp_ns, features, stereo, rays, prior });
        }
    }
    progress(Stage::Seeing, candidates.len(), candidates.len());
    if views.is_empty() {
        return Err(BuildError::NoCommonStamps {
            images: candidates.len(),
            poses: references.len(),
            in_time: candidates.iter().filter(|frame| in_time(frame)).count(),
        });
    }
    Ok(views)
}

/// How far a camera has moved or turned, as a part of what makes a new keyframe.
fn view_change(last: &PoseWithCovariance, now: &PoseWithCovariance, options: &BuildOptions) -> f64 {
    let distance = (last.pose.translation - now.pose.translation).norm();
    let angle = last.pose.rotation.angle_to(&now.pose.rotation);
    (distance / options.min_distance).max(angle / options.min_rotation)
}

/// The part of a keyframe's features that are found again in another image.
fn overlap(last: &View<'_>, features: &FeatureSet) -> Result<f64, DescriptorError> {
    let (known, seen) = (last.descriptors()?, descriptors(features)?);
    let found = match_descriptors(known, seen, &MatchOptions::for_metric(known.metric()))?;
    Ok(found.len() as f64 / known.len().min(seen.len()).max(1) as f64)
}

/// The camera's pose and covariance from the IMU's: the lever arm turns rotation errors into position errors.
fn camera_pose(
    reference: &ReferencePose,
    imu_from_camera: &geometry::pose::Pose,
    options: &BuildOptions,
) -> PoseWithCovariance {
    let covariance = isotropic_covariance(
        options.sigma_theta_rad.unwrap_or(reference.sigma_theta_rad),
        options.sigma_p_m.unwrap_or(reference.sigma_p_m),
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
