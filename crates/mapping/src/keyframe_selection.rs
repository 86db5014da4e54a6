//! Keyframe selection: which images become keyframes.

use std::collections::BTreeMap;

use geometry::camera::Camera;
use geometry::uncertain_pose::PoseWithCovariance;
use nalgebra::Vector2;
use protocol::FeatureSet;
use sensors::{Frame, ReferencePose, Sequence};
use vision::{DescriptorError, MatchOptions, match_descriptors};

use super::error::BuildError;
use super::feature_source::{FeatureSource, ImageWithFeatures};
use super::keyframe_view::{KeyframeImage, KeyframeView, descriptors};
use super::options::BuildOptions;
use super::progress::{Progress, Stage};
use super::reference_poses::ReferencePoses;

/// Part of the thresholds of motion from which on features are extracted and compared with the last keyframe: images
/// before are skipped, since extraction is expensive.
const EXTRACTION_THRESHOLD: f64 = 0.5;
/// The next comparison is after this much more motion.
const EXTRACTION_STEP: f64 = 0.25;

/// Selects keyframes: images with a pose, when the camera has moved enough since the last keyframe, or when too few of its
/// features are matched. All images of a frame become keyframes together.
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
    let mut selector = KeyframeSelector::new(options);
    for (done, &(frame, ref prior)) in with_pose.iter().enumerate() {
        progress(Stage::KeyframeSelection, done, with_pose.len());
        let later = with_pose[done + 1..].iter().map(|(frame, prior)| (*frame, prior));
        views.extend(selector.consider(&views, (frame, prior), later, source)?);
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
///
/// Cameras that are triggered apart, whose images are frames of their own, have keyframes of their own.
pub(super) struct KeyframeSelector<'o> {
    options: &'o BuildOptions,
    /// Motion since the last keyframe from which on the next frame is compared with it, by the first group of the frame.
    next_comparison: BTreeMap<usize, f64>,
}

impl<'o> KeyframeSelector<'o> {
    /// Before the first image.
    pub(super) fn new(options: &'o BuildOptions) -> KeyframeSelector<'o> {
        KeyframeSelector { options, next_comparison: BTreeMap::new() }
    }

    /// Considers one frame.
    ///
    /// # Arguments
    /// * `views`: the keyframes so far.
    /// * `later`: frames that come after this one, as far as they are known: some may be extracted ahead.
    ///
    /// # Returns
    /// The keyframes that its images become.
    ///
    /// # Errors
    /// As those of [`FeatureSource::stereo_features_of`].
    pub(super) fn consider<'f: 'l, 'l>(
        &mut self,
        views: &[KeyframeView<'_>],
        (frame, prior): (&'f Frame, &'l PoseWithCovariance),
        later: impl Iterator<Item = (&'l Frame, &'l PoseWithCovariance)>,
        source: &mut FeatureSource<'_, '_>,
    ) -> Result<Option<KeyframeView<'f>>, BuildError> {
        let groups: Vec<usize> = source.groups_of(frame).collect();
        let Some(&leading) = groups.first() else { return Ok(None) };
        let shared =
            |view: &KeyframeView<'_>| groups.iter().copied().find(|&group| view.image_of(group).is_some());
        let last = views.iter().rev().find_map(|view| Some((view, shared(view)?)));
        let next_comparison = self.next_comparison.get(&leading).copied().unwrap_or(EXTRACTION_THRESHOLD);
        let change =
            last.map_or(f64::INFINITY, |(last, _)| relative_motion(&last.prior, prior, self.options));
        if change < next_comparison.min(1.0) {
            return Ok(None);
        }
        source.forget_before(frame.stamp_ns);
        let later = later.filter(|(frame, _)| source.groups_of(frame).next() == Some(leading));
        let images = std::iter::once((frame, prior)).chain(later);
        let wanted = self.wanted(last.map(|(last, _)| last.prior), next_comparison, images, source);
        if wanted.first().is_some_and(|(first, _)| first.stamp_ns == frame.stamp_ns) {
            source.prepare(&wanted);
        }
        if let Some((last, group)) = last.filter(|_| change < 1.0) {
            self.next_comparison.insert(leading, change + EXTRACTION_STEP);
            let Some(features) = source.features_of(frame, group)? else { return Ok(None) };
            let known = last.image_of(group).map_or(Ok(0.0), |known| overlap(known, &features))?;
            if known >= self.options.min_overlap {
                return Ok(None);
            }
        }
        let view = view_of(frame, prior, &groups, source)?;
        if view.is_some() {
            self.next_comparison.insert(leading, EXTRACTION_THRESHOLD);
        }
        Ok(view)
    }

    /// The images, and of which camera, that are extracted next if those that are compared overlap enough: as many as are
    /// extracted at the same time.
    fn wanted<'l>(
        &self,
        mut last: Option<PoseWithCovariance>,
        mut next_comparison: f64,
        images: impl Iterator<Item = (&'l Frame, &'l PoseWithCovariance)>,
        source: &FeatureSource<'_, '_>,
    ) -> Vec<(&'l Frame, usize)> {
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
            let compared = if is_keyframe { usize::MAX } else { 1 };
            let missing =
                source.cameras_of(frame).take(compared).filter(|&camera| !source.is_ready(frame, camera));
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

/// The view of a frame, with its images that have features; `None` where there are none.
fn view_of<'f>(
    frame: &'f Frame,
    prior: &PoseWithCovariance,
    groups: &[usize],
    source: &mut FeatureSource<'_, '_>,
) -> Result<Option<KeyframeView<'f>>, BuildError> {
    let (mut images, mut bearings, mut in_second) = (Vec::new(), Vec::new(), Vec::new());
    for &group in groups {
        let Some(ImageWithFeatures { features, stereo }) = source.stereo_features_of(frame, group)? else {
            continue;
        };
        if features.is_empty() {
            continue;
        }
        in_second.resize(bearings.len(), None);
        in_second.extend(stereo);
        bearings.extend(rays(source.projection_of(group), &features));
        images.push(KeyframeImage { group, features });
    }
    Ok((!images.is_empty()).then(|| KeyframeView {
        stamp_ns: frame.stamp_ns,
        images,
        tracked: Vec::new(),
        stereo: in_second,
        rays: bearings,
        prior: *prior,
    }))
}

/// The part of a keyframe's features that are matched in another image.
fn overlap(last: &KeyframeImage<'_>, features: &FeatureSet) -> Result<f64, DescriptorError> {
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
    let ReferencePose { pose, covariance, .. } =
        reference.with_sigmas(options.sigma_theta_rad, options.sigma_p_m);
    PoseWithCovariance::new(pose, covariance).change_of_child(imu_from_camera)
}

pub(super) fn rays(camera: &Camera, features: &FeatureSet) -> Vec<Option<Vector2<f64>>> {
    let ray = |&[u, v]: &[f32; 2]| {
        let pixel = Vector2::new(f64::from(u), f64::from(v));
        camera.contains(&pixel).then(|| camera.unproject(&pixel).ok()).flatten()
    };
    features.pixels.iter().map(ray).collect()
}
