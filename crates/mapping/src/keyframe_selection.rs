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
    let in_time = |frame: &&&Frame| is_in_time(frame.stamp_ns, first.stamp_ns, options);
    let with_pose: Vec<(&Frame, PoseWithCovariance)> = candidates
        .iter()
        .filter(in_time)
        .filter_map(|frame| {
            let reference = poses.at(frame.stamp_ns)?;
            Some((*frame, camera_pose(&reference, &sensor.imu_from_camera, options)))
        })
        .collect();
    let mut views: Vec<KeyframeView<'a>> = Vec::new();
    let mut selector = KeyframeSelector::new(&sensor.camera, options);
    for (done, &(frame, ref prior)) in with_pose.iter().enumerate() {
        progress(Stage::KeyframeSelection, done, with_pose.len());
        let later = with_pose[done + 1..].iter().map(|(frame, prior)| (*frame, prior));
        views.extend(selector.consider(views.last(), (frame, prior), later, source)?);
    }
    progress(Stage::KeyframeSelection, with_pose.len(), with_pose.len());
    if views.is_empty() {
        return Err(no_common_stamps(sequence, references.len(), source, options));
    }
    Ok(views)
}

/// The error for a recording in which no image becomes a keyframe.
///
/// # Arguments
/// * `poses`: number of poses that were given.
pub(super) fn no_common_stamps(
    sequence: &Sequence,
    poses: usize,
    source: &FeatureSource<'_, '_>,
    options: &BuildOptions,
) -> BuildError {
    let first_ns = sequence.frames.first().map_or(0, |first| first.stamp_ns);
    let images = || sequence.frames.iter().filter(|frame| source.has_features(frame));
    let in_time = images().filter(|frame| is_in_time(frame.stamp_ns, first_ns, options)).count();
    BuildError::NoCommonStamps { images: images().count(), poses, in_time }
}

/// Whether an image is between the times of the options.
pub(super) fn is_in_time(stamp_ns: i64, first_ns: i64, options: &BuildOptions) -> bool {
    let seconds = (stamp_ns - first_ns) as f64 * 1e-9;
    (options.from_s..=options.until_s).contains(&seconds)
}

/// Selects keyframes from images that are given one by one.
pub(super) struct KeyframeSelector<'o> {
    camera: &'o Camera,
    options: &'o BuildOptions,
    /// Motion since the last keyframe from which on the next image is compared with it.
    next_comparison: f64,
}

impl<'o> KeyframeSelector<'o> {
    /// Before the first image.
    pub(super) fn new(camera: &'o Camera, options: &'o BuildOptions) -> KeyframeSelector<'o> {
        KeyframeSelector { camera, options, next_comparison: EXTRACTION_THRESHOLD }
    }

    /// Considers one image.
    ///
    /// # Arguments
    /// * `last`: the last keyframe.
    /// * `later`: images that come after this one, as far as they are known: some may be extracted ahead.
    ///
    /// # Returns
    /// The keyframe that it becomes.
    ///
    /// # Errors
    /// As those of [`FeatureSource::stereo_features_of`].
    pub(super) fn consider<'f: 'l, 'l>(
        &mut self,
        last: Option<&KeyframeView<'_>>,
        (frame, prior): (&'f Frame, &'l PoseWithCovariance),
        later: impl Iterator<Item = (&'l Frame, &'l PoseWithCovariance)>,
        source: &mut FeatureSource<'_, '_>,
    ) -> Result<Option<KeyframeView<'f>>, BuildError> {
        let change = last.map_or(f64::INFINITY, |last| relative_motion(&last.prior, prior, self.options));
        if change < self.next_comparison.min(1.0) {
            return Ok(None);
        }
        source.forget_before(frame.stamp_ns);
        let wanted = self.wanted(last, std::iter::once((frame, prior)).chain(later), source);
        if wanted.first().is_some_and(|(first, _)| first.stamp_ns == frame.stamp_ns) {
            source.prepare(&wanted);
        }
        if let Some(last) = last.filter(|_| change < 1.0) {
            self.next_comparison = change + EXTRACTION_STEP;
            let Some(features) = source.features_of(frame)? else { return Ok(None) };
            if overlap(last, &features)? >= self.options.min_overlap {
                return Ok(None);
            }
        }
        let Some(FrameFeatures { features, stereo }) = source.stereo_features_of(frame)? else {
            return Ok(None);
        };
        if features.is_empty() {
            return Ok(None);
        }
        self.next_comparison = EXTRACTION_THRESHOLD;
        let (stamp_ns, tracked) = (frame.stamp_ns, Vec::new());
        let rays = rays(self.camera, &features);
        Ok(Some(KeyframeView { stamp_ns, features, tracked, stereo, rays, prior: *prior }))
    }

    /// The images, and of which camera, that are extracted next if those that are compared overlap enough: as many as are
    /// extracted at the same time.
    fn wanted<'l>(
        &self,
        last: Option<&KeyframeView<'_>>,
        images: impl Iterator<Item = (&'l Frame, &'l PoseWithCovariance)>,
        source: &FeatureSource<'_, '_>,
    ) -> Vec<(&'l Frame, usize)> {
        let mut last = last.map(|last| last.prior);
        let mut next_comparison = self.next_comparison;
        let mut wanted = Vec::new();
        for (frame, prior) in images {
            if wanted.len() >= source.at_once() {
                break;
            }
            let change =
                last.as_ref().map_or(f64::INFINITY, |last| relative_motion(last, prior, self.options));
            if change < next_comparison.min(1.0) {
                continue;
            }
            let is_keyframe = change >= 1.0;
            let cameras = if is_keyframe && source.is_stereo() { 0..2 } else { 0..1 };
            let missing = cameras.filter(|&camera| !source.is_ready(frame, camera));
            wanted.extend(missing.map(|camera| (frame, camera)));
            next_comparison = change + EXTRACTION_STEP;
            if is_keyframe {
                (last, next_comparison) = (Some(*prior), EXTRACTION_THRESHOLD);
            }
        }
        wanted
    }
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
