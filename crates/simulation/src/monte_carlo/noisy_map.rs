//! A map with errors: keyframe poses with the stated covariance, pixels with noise, sampled once a seed.
//!
//! Each keyframe's pose has an independent error. Landmarks are triangulated from the noisy pixels and expressed in the
//! keyframes' frames, where that error has no effect; so near a keyframe the map is as good as its pixels, but for an error
//! that all landmarks of a keyframe share.

use super::{MapOptions, global_from_world};
use crate::SimulatedWorld;
use crate::SimulationOptions;
use crate::exposure::Exposure;
use crate::random::{Purpose, normal, normal3, stream};
use crate::tracks::visible;
use geometry::triangulation::{TriangulationOptions, View, triangulate};
use geometry::{Camera, Pose, PoseWithCovariance};
use nalgebra::{Matrix6, Vector2, Vector3, Vector6};
use rand::RngExt;
use rand::seq::SliceRandom;
use std::collections::{BTreeMap, HashMap};

/// Rotation after which a keyframe is made, rad.
pub(crate) const KEYFRAME_TURN: f64 = 0.35;
/// Step along the trajectory, nanoseconds.
const STEP_NS: i64 = 50_000_000;
/// Most views that a landmark is triangulated from.
const MAX_VIEWS: usize = 8;

/// A keyframe.
#[derive(Clone)]
pub(crate) struct Keyframe {
    /// Its pose in G as the map states it, with covariance.
    pub(crate) stated: PoseWithCovariance,
    /// Its true pose.
    pub(crate) world_from_camera: Pose,
    /// Error that its landmarks share in its camera's frame, as a fraction of their distance.
    pub(crate) shift: Vector3<f64>,
    /// Pixels of the landmarks that it observes.
    pub(crate) seen: BTreeMap<usize, Vector2<f64>>,
}

/// The map of one seed.
#[derive(Clone)]
pub(crate) struct NoisyMap {
    /// Its camera.
    pub(crate) camera: Camera,
    /// Keyframes along the map's trajectory.
    pub(crate) keyframes: Vec<Keyframe>,
    /// Triangulated landmarks in the simulated world, metres.
    pub(crate) landmarks: HashMap<usize, Vector3<f64>>,
    /// Keyframes that observe each landmark.
    pub(crate) observers: HashMap<usize, Vec<usize>>,
    /// Noise of its pixels, px.
    pub(crate) sigma_px: f64,
}

impl NoisyMap {
    /// Maps a world along the map's trajectory. Each version has its own noise.
    pub(crate) fn new(
        options: &MapOptions,
        simulation: &SimulationOptions,
        version: u64,
        world: &SimulatedWorld,
    ) -> Self {
        let mut rng = stream(simulation.seed, version, Purpose::NoisyMap);
        let mut shifts = stream(simulation.seed, version, Purpose::MapShift);
        let (camera, sigma_px) = (&world.cameras[0], simulation.sigma_feature_px);
        let mut map = Self {
            camera: camera.camera.clone(),
            keyframes: Vec::new(),
            landmarks: HashMap::new(),
            observers: HashMap::new(),
            sigma_px,
        };
        let covariance = Matrix6::from_diagonal(&Vector6::from_fn(|k, _| {
            if k < 3 { options.sigma_theta_rad.powi(2) } else { options.sigma_p_m.powi(2) }
        }));
        for world_from_imu in keyframe_poses(options, world) {
            let mut seen = visible(simulation, &Exposure::at_once(world_from_imu), camera, &world.landmarks);
            seen.retain(|_| rng.random_bool(simulation.repeatability));
            seen.shuffle(&mut rng);
            seen.truncate(simulation.max_features);
            let mut noisy =
                |exact: Vector2<f64>| exact + Vector2::new(normal(&mut rng), normal(&mut rng)) * sigma_px;
            let seen: BTreeMap<usize, Vector2<f64>> = seen
                .into_iter()
                .map(|(landmark, pixel)| (landmark, noisy(pixel)))
                .filter(|(_, pixel)| camera.camera.contains(pixel))
                .collect();
            for &landmark in seen.keys() {
                map.observers.entry(landmark).or_default().push(map.keyframes.len());
            }
            let world_from_camera = world_from_imu * camera.imu_from_camera;
            let (turn, shift) =
                (normal3(&mut rng) * options.sigma_theta_rad, normal3(&mut rng) * options.sigma_p_m);
            let error = Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z);
            let pose = (global_from_world() * world_from_camera).retract(&-error);
            let stated = PoseWithCovariance::new(pose, covariance);
            let shift = normal3(&mut shifts) * options.shift;
            map.keyframes.push(Keyframe { stated, world_from_camera, shift, seen });
        }
        map.triangulate_landmarks();
        map
    }

    /// A landmark in a keyframe's camera as the map states it, metres.
    pub(crate) fn position_in(&self, keyframe: usize, landmark: usize) -> Vector3<f64> {
        let keyframe = &self.keyframes[keyframe];
        let position = keyframe.world_from_camera.inverse_transform(&self.landmarks[&landmark]);
        position + keyframe.shift * position.norm()
    }

    fn triangulate_landmarks(&mut self) {
        for (&landmark, observers) in &self.observers {
            // Distributed over all observers, for a long baseline.
            let step = observers.len().div_ceil(MAX_VIEWS).max(1);
            let views: Vec<View> = observers
                .iter()
                .step_by(step)
                .map(|&keyframe| {
                    let keyframe = &self.keyframes[keyframe];
                    View {
                        parent_from_camera: keyframe.world_from_camera,
                        pixel: keyframe.seen[&landmark],
                        sigma_px: self.sigma_px.max(0.1),
                    }
                })
                .collect();
            let cameras = vec![&self.camera; views.len()];
            if let Ok(found) = triangulate(&cameras, &views, &TriangulationOptions::default()) {
                self.landmarks.insert(landmark, found.position);
            }
        }
    }
}

/// The poses at which keyframes are made: `world_from_imu`.
fn keyframe_poses(options: &MapOptions, world: &SimulatedWorld) -> Vec<Pose> {
    let trajectory = &world.map_trajectory;
    let mut poses: Vec<Pose> = Vec::new();
    for stamp_ns in (trajectory.start_ns()..trajectory.end_ns()).step_by(STEP_NS as usize) {
        let pose = trajectory.at(stamp_ns).pose;
        let is_far = poses.last().is_none_or(|last| {
            (pose.translation - last.translation).norm() >= options.keyframe_distance_m
                || pose.rotation.angle_to(&last.rotation) >= KEYFRAME_TURN
        });
        if is_far {
            poses.push(pose);
        }
    }
    poses
}
