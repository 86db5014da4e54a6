//! The place: landmarks where the cameras look, each with a descriptor.

use super::SimulationOptions;
use super::random::{Purpose, stream};
use super::spline::Spline;
use geometry::rotation;
use nalgebra::{Vector2, Vector3};
use rand::RngExt;
use rand::rngs::StdRng;
use sensors::CameraSensor;

/// Bytes a descriptor (256 bits).
pub(crate) const DESCRIPTOR_BYTES: usize = 32;
/// A turn of one radian shows as much of the place as so many metres of way.
const METRES_A_RADIAN: f64 = 5.0;
/// The way is looked at in steps of so long.
const STEP_NS: i64 = 50_000_000;

/// A point of the place.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Landmark {
    /// Where, in the world, metres.
    pub(crate) position: Vector3<f64>,
    /// What it looks like.
    pub(crate) descriptor: [u8; DESCRIPTOR_BYTES],
}

/// Spreads landmarks along the ways of all runs, evenly by what the camera gets to see.
pub(crate) fn landmarks(
    options: &SimulationOptions,
    camera: &CameraSensor,
    ways: &[Spline],
) -> Vec<Landmark> {
    let mut rng = stream(options.seed, 0, Purpose::World);
    let mut landmarks: Vec<Landmark> = Vec::new();
    // Each run brings its share, so that both see the same density.
    let density = options.landmarks_per_metre / ways.len() as f64;
    for way in ways {
        // The start is looked at as if it had been driven to.
        let mut due = density * 15.0;
        let mut before = way.at(way.start_ns()).pose;
        for stamp_ns in (way.start_ns()..way.end_ns()).step_by(STEP_NS as usize) {
            let pose = way.at(stamp_ns).pose;
            let turned = rotation::log(&(before.rotation.inverse() * pose.rotation)).norm();
            due += density * ((pose.translation - before.translation).norm() + METRES_A_RADIAN * turned);
            before = pose;
            while due >= 1.0 {
                due -= 1.0;
                if let Some(in_camera) = visible_point(&mut rng, options, camera) {
                    let position = pose.compose(&camera.imu_from_camera).transform(&in_camera);
                    let descriptor = look(&mut rng, options, &landmarks);
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

/// A descriptor of its own, or now and then the one of another landmark: windows, bricks, railings.
fn look(rng: &mut StdRng, options: &SimulationOptions, others: &[Landmark]) -> [u8; DESCRIPTOR_BYTES] {
    if !others.is_empty() && rng.random_bool(options.repeated_texture) {
        return others[rng.random_range(0..others.len())].descriptor;
    }
    rng.random()
}
