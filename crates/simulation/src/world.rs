//! The simulated world: landmarks in front of the cameras, each with a descriptor.

use super::SimulationOptions;
use super::random::{Purpose, stream};
use super::spline::Spline;
use geometry::rotation;
use nalgebra::{Vector2, Vector3};
use rand::RngExt;
use rand::rngs::StdRng;
use sensors::{CameraSensor, camera_groups};

/// Bytes a descriptor (256 bits).
pub(crate) const DESCRIPTOR_BYTES: usize = 32;
/// Metres of trajectory that show as many new landmarks as a rotation of one radian.
const METRES_A_RADIAN: f64 = 5.0;
/// Step along the trajectory, nanoseconds.
const STEP_NS: i64 = 50_000_000;

/// A landmark.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Landmark {
    /// Position in the world, metres.
    pub(crate) position: Vector3<f64>,
    /// Its descriptor, without noise.
    pub(crate) descriptor: [u8; DESCRIPTOR_BYTES],
}

/// Distributes landmarks along the trajectories of all runs, in proportion to what each stereo pair or single camera newly sees.
pub(crate) fn landmarks(
    options: &SimulationOptions,
    cameras: &[CameraSensor],
    trajectories: &[Spline],
) -> Vec<Landmark> {
    let mut rng = stream(options.seed, 0, Purpose::World);
    let mut landmarks: Vec<Landmark> = Vec::new();
    // Each run contributes its part, so that both see the same density.
    let density = options.landmarks_per_metre / trajectories.len() as f64;
    let groups = camera_groups(cameras);
    let firsts = groups.iter().map(|group| &cameras[group.first]);
    for (camera, trajectory) in firsts.flat_map(|camera| trajectories.iter().map(move |of| (camera, of))) {
        // The view of the start has as many landmarks as one reached by driving.
        let mut due = density * 15.0;
        let mut before = trajectory.at(trajectory.start_ns()).pose;
        for stamp_ns in (trajectory.start_ns()..trajectory.end_ns()).step_by(STEP_NS as usize) {
            let pose = trajectory.at(stamp_ns).pose;
            let turned = rotation::log(&(before.rotation.inverse() * pose.rotation)).norm();
            due += density * ((pose.translation - before.translation).norm() + METRES_A_RADIAN * turned);
            before = pose;
            while due >= 1.0 {
                due -= 1.0;
                if let Some(in_camera) = visible_point(&mut rng, options, camera) {
                    let position = pose.compose(&camera.imu_from_camera).transform(&in_camera);
                    let descriptor = new_descriptor(&mut rng, options, &landmarks);
                    landmarks.push(Landmark { position, descriptor });
                }
            }
        }
    }
    landmarks
}

/// A point that the camera sees, in the camera frame.
fn visible_point(
    rng: &mut StdRng,
    options: &SimulationOptions,
    sensor: &CameraSensor,
) -> Option<Vector3<f64>> {
    let (width, height) = (f64::from(sensor.camera.width), f64::from(sensor.camera.height));
    let pixel = Vector2::new(rng.random_range(0.0..width - 1.0), rng.random_range(0.0..height - 1.0));
    let depth = rng.random_range(options.depth_m[0]..options.depth_m[1]);
    let normalized = sensor.camera.unproject(&pixel).ok()?;
    Some(Vector3::new(normalized.x, normalized.y, 1.0) * depth)
}

/// A new descriptor, or that of another landmark (repeated texture: windows, bricks, railings).
fn new_descriptor(
    rng: &mut StdRng,
    options: &SimulationOptions,
    others: &[Landmark],
) -> [u8; DESCRIPTOR_BYTES] {
    if !others.is_empty() && rng.random_bool(options.repeated_texture) {
        return others[rng.random_range(0..others.len())].descriptor;
    }
    rng.random()
}
