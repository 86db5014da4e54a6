//! What odometry knows of a recording, and the views of a map that is built from it.

use std::collections::HashMap;
use std::sync::Arc;

use estimator::propagation::ImuState;
use estimator::{EstimatorConfig, TrackObservation};
use geometry::pose::Pose;
use geometry::uncertain_pose::PoseWithCovariance;
use nalgebra::Vector2;
use sensors::{CameraSensor, Frame, ReferencePose, Sequence};

use super::camera::Rig;
use super::error::BuildError;
use super::feature_source::FeatureSource;
use super::keyframe_selection::{camera_pose, no_common_stamps, select_keyframes};
use super::keyframe_view::{FeatureId, KeyframeView, TrackedPoint};
use super::options::BuildOptions;
use super::progress::Progress;
use super::selected_keyframes::SelectedKeyframes;

/// Uncertainty of the odometry between keyframes that are matched with each other (rad, m): what the epipolar constraint
/// and the first triangulation are relaxed by. It has hardly drifted between neighbours.
pub(super) const LOCAL_SIGMAS: [f64; 2] = [0.005, 0.03];
/// Longest time between views (ns): what drifts between keyframes is measured by every view that shows their tracks.
const MAX_INTERVAL_NS: i64 = 300_000_000;

/// The odometry of a recording.
#[derive(Clone, Debug)]
pub struct Odometry {
    /// Time of an image (ns), and the state then: pose of the IMU in L, velocity in L, biases. In order of time.
    pub states: Vec<(i64, ImuState)>,
    /// Number of cameras that were used, the first ones.
    pub cameras: usize,
    /// Factor on the stated noise of the IMU that was learned; 1 where none was.
    pub imu_noise_scale: f64,
    /// Settings of the estimator that was run: the stated noise of the IMU, gravity, initial standard deviations.
    pub config: EstimatorConfig,
    /// Keyframes that were selected while it ran, with the options that the map is built with (see [`crate::select_during`]);
    /// `None` selects them when it is built.
    pub keyframes: Option<Arc<SelectedKeyframes>>,
}

impl Odometry {
    /// The same states in another frame with z up.
    ///
    /// # Arguments
    /// * `to_frame`: from the frame of the states, a rotation about z and a translation.
    pub(super) fn moved(&self, to_frame: &Pose) -> Odometry {
        let state = |state: &ImuState| ImuState {
            local_from_imu: to_frame.compose(&state.local_from_imu),
            velocity: to_frame.rotation * state.velocity,
            ..*state
        };
        let states = self.states.iter().map(|(stamp_ns, of)| (*stamp_ns, state(of))).collect();
        Odometry { states, config: self.config.clone(), keyframes: self.keyframes.clone(), ..*self }
    }

    /// The state at the time of an image.
    pub(super) fn at(&self, stamp_ns: i64) -> Option<&ImuState> {
        let at = self.states.binary_search_by_key(&stamp_ns, |(stamp_ns, _)| *stamp_ns).ok()?;
        Some(&self.states[at].1)
    }

    /// The views: keyframes as the camera moves, and in between images that are tied to them by tracks.
    ///
    /// # Errors
    /// [`BuildError`] where there is no keyframe.
    pub(super) fn select_views<'a>(
        &'a self,
        sequence: &'a Sequence,
        source: &mut FeatureSource<'_, '_>,
        options: &BuildOptions,
        progress: Progress<'_>,
    ) -> Result<Vec<KeyframeView<'a>>, BuildError> {
        let without_states = || sequence.frames.iter().all(|frame| self.at(frame.stamp_ns).is_none());
        if without_states() {
            return Err(BuildError::NoOdometry { states: self.states.len() });
        }
        let keyframes = self.keyframes(sequence, source, options, progress)?;
        let mut views: Vec<KeyframeView<'a>> = Vec::with_capacity(keyframes.len());
        for keyframe in keyframes {
            if let Some(last_ns) = views.last().map(|view| view.stamp_ns) {
                let frames = between(&sequence.frames, last_ns, keyframe.stamp_ns);
                for frame in spaced(frames, last_ns, keyframe.stamp_ns) {
                    let Some(state) = self.at(frame.stamp_ns) else { continue };
                    let prior = local_prior(frame.stamp_ns, state, &sequence.cameras[0], options);
                    views.push(bridging_view(frame.stamp_ns, &prior));
                }
            }
            views.push(keyframe);
        }
        views.retain(|view| self.at(view.stamp_ns).is_some());
        if views.is_empty() {
            return Err(BuildError::NoOdometry { states: self.states.len() });
        }
        Ok(views)
    }

    /// The keyframes: those that were selected already, or selected now.
    fn keyframes<'a>(
        &'a self,
        sequence: &'a Sequence,
        source: &mut FeatureSource<'_, '_>,
        options: &BuildOptions,
        progress: Progress<'_>,
    ) -> Result<Vec<KeyframeView<'a>>, BuildError> {
        let Some(selected) = &self.keyframes else {
            let references: Vec<ReferencePose> =
                self.states.iter().map(|(stamp_ns, state)| local_reference(*stamp_ns, state)).collect();
            return select_keyframes(sequence, &references, source, options, progress);
        };
        source.unreadable.clone_from(&selected.unreadable);
        if selected.views.is_empty() {
            return Err(no_common_stamps(sequence, self.states.len(), source, options));
        }
        let view = |selected: &'a KeyframeView<'static>| {
            let state = self.at(selected.stamp_ns)?;
            Some(selected.borrowed(&local_prior(selected.stamp_ns, state, &sequence.cameras[0], options)))
        };
        Ok(selected.views.iter().filter_map(view).collect())
    }
}

/// The pose of a camera at a state, as certain as it is relative to its neighbours.
pub(super) fn local_prior(
    stamp_ns: i64,
    state: &ImuState,
    sensor: &CameraSensor,
    options: &BuildOptions,
) -> PoseWithCovariance {
    camera_pose(&local_reference(stamp_ns, state), &sensor.imu_from_camera, options)
}

/// The pose of a state, as certain as it is relative to its neighbours.
pub(super) fn local_reference(stamp_ns: i64, state: &ImuState) -> ReferencePose {
    let [sigma_theta, sigma_p] = LOCAL_SIGMAS;
    ReferencePose::isotropic(stamp_ns, state.local_from_imu, sigma_theta, sigma_p)
}

/// A view without features of its own, which ties keyframes together by tracks.
fn bridging_view<'a>(stamp_ns: i64, prior: &PoseWithCovariance) -> KeyframeView<'a> {
    KeyframeView {
        stamp_ns,
        images: Vec::new(),
        tracked: Vec::new(),
        stereo: Vec::new(),
        rays: Vec::new(),
        prior: *prior,
    }
}

/// The frames after one time and before another.
fn between(frames: &[Frame], from_ns: i64, to_ns: i64) -> &[Frame] {
    let begin = frames.partition_point(|frame| frame.stamp_ns <= from_ns);
    let end = frames.partition_point(|frame| frame.stamp_ns < to_ns);
    &frames[begin..end.max(begin)]
}

/// Frames with tracks, so many that no interval is longer than [`MAX_INTERVAL_NS`] where there are some.
fn spaced(frames: &[Frame], from_ns: i64, to_ns: i64) -> impl Iterator<Item = &Frame> {
    let parts = ((to_ns - from_ns + MAX_INTERVAL_NS - 1) / MAX_INTERVAL_NS).max(1);
    let mut last_part = 0;
    frames.iter().filter(move |frame| {
        let part = (frame.stamp_ns - from_ns) * parts / (to_ns - from_ns).max(1);
        let is_first = part > last_part && !frame.tracks.is_empty();
        if is_first {
            last_part = part;
        }
        is_first
    })
}

/// Adds the points that the odometry tracks to the views.
///
/// A track is broken where its point is not seen in an image: front ends may give its name to another point.
///
/// # Arguments
/// * `frames`: all of the recording.
///
/// # Returns
/// The tracks of at least two views.
pub(super) fn add_tracks(views: &mut [KeyframeView<'_>], frames: &[Frame], rig: &Rig) -> Vec<Vec<FeatureId>> {
    let view_at: HashMap<i64, usize> =
        views.iter().enumerate().map(|(index, view)| (view.stamp_ns, index)).collect();
    let mut tracks: Vec<Vec<FeatureId>> = Vec::new();
    // The track of each point that the last image of its camera shows, by camera and name.
    let mut alive: HashMap<(u8, u64), usize> = HashMap::new();
    for frame in frames {
        let in_view = view_at.get(&frame.stamp_ns).copied();
        if let Some(index) = in_view {
            let described = views[index].described();
            views[index].stereo.resize(described, None);
        }
        for (group, cameras) in rig.groups.iter().enumerate() {
            let of_camera =
                |camera: usize| frame.tracks.iter().filter(move |point| usize::from(point.camera) == camera);
            let name = |point: &TrackObservation| (point.camera, point.feature_id);
            let is_alone = rig.groups.len() == 1 || frame.tracks.is_empty();
            let has_image = frame.images.contains_key(&cameras.first)
                || (frame.images.is_empty() && (is_alone || of_camera(cameras.first).next().is_some()));
            let mut seen = HashMap::new();
            for point in of_camera(cameras.first) {
                let track = alive.get(&name(point)).copied().unwrap_or_else(|| {
                    tracks.push(Vec::new());
                    tracks.len() - 1
                });
                seen.insert(name(point), track);
            }
            if has_image {
                alive.retain(|(camera, _), _| usize::from(*camera) != cameras.first);
            }
            alive.extend(&seen);
            let Some(index) = in_view else { continue };
            let (view, camera) = (&mut views[index], rig.camera(group));
            let second: HashMap<u64, Vector2<f64>> = cameras
                .second
                .map(|second| of_camera(second).map(|point| (point.feature_id, point.pixel)).collect())
                .unwrap_or_default();
            for point in of_camera(cameras.first) {
                let ray =
                    camera.contains(&point.pixel).then(|| camera.unproject(&point.pixel).ok()).flatten();
                if ray.is_none() {
                    continue;
                }
                tracks[seen[&name(point)]].push((index, view.rays.len()));
                view.tracked.push(TrackedPoint { group, pixel: point.pixel });
                view.rays.push(ray);
                view.stereo.push(second.get(&point.feature_id).copied());
            }
        }
    }
    tracks.retain(|track| track.len() >= 2);
    tracks
}
