//! A calibration that is wrong: what the filter is told of its cameras, beside what they are.
//!
//! The pair of cameras is turned and moved on the body as one piece, and both lenses are off by the same factor: what was
//! calibrated together is wrong together. Sizes are the given ones in every run; directions and signs are drawn.

use crate::random::{Purpose, normal, normal3, stream};
use estimator::CalibratedCamera;
use geometry::{Pose, rotation};
use nalgebra::Vector3;
use serde::Serialize;

/// How wrong the stated calibration is, by its sizes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CalibrationErrors {
    /// Angle by which the cameras are turned on the body, rad.
    pub rotation_rad: f64,
    /// Distance by which they are moved on it, metres.
    pub translation_m: f64,
    /// Stamps of images are late or early by so much, seconds.
    pub time_offset_s: f64,
    /// The focal lengths are off by this fraction.
    pub focal_fraction: f64,
}

/// The calibration that a filter is told in one run.
#[derive(Clone, Debug)]
pub(crate) struct Stated {
    /// The cameras.
    pub(crate) rig: Vec<CalibratedCamera>,
    /// What is added to the true time of an image, nanoseconds.
    pub(crate) image_delay_ns: i64,
}

impl CalibrationErrors {
    /// Draws directions and signs for one run.
    pub(crate) fn draw(&self, seed: u64, truth: &[CalibratedCamera]) -> Stated {
        let mut rng = stream(seed, 1, Purpose::Calibration);
        let turn = direction(normal3(&mut rng)) * self.rotation_rad;
        let shift = direction(normal3(&mut rng)) * self.translation_m;
        let mut sign = || normal(&mut rng).signum();
        let (delay, longer) = (sign() * self.time_offset_s, 1.0 + sign() * self.focal_fraction);
        let told = |eye: &CalibratedCamera| {
            let mut told = eye.clone();
            told.imu_from_camera = Pose::new(
                rotation::exp(&turn) * eye.imu_from_camera.rotation,
                eye.imu_from_camera.translation + shift,
            );
            told.camera.focal = eye.camera.focal.map(|focal| focal * longer);
            told
        };
        Stated { rig: truth.iter().map(told).collect(), image_delay_ns: (delay * 1e9).round() as i64 }
    }
}

fn direction(drawn: Vector3<f64>) -> Vector3<f64> {
    drawn.try_normalize(1e-9).unwrap_or_else(Vector3::x)
}

/// How far one camera's calibration is from the truth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct CalibrationError {
    /// Rotation, degrees.
    pub deg: f64,
    /// Position on the body, metres.
    pub m: f64,
    /// Time of images, seconds: what is believed to be their delay minus what it is.
    pub seconds: f64,
    /// Focal length, as a fraction, the larger of both.
    pub focal_fraction: f64,
}

impl CalibrationError {
    /// Of what a filter believes, told or estimated.
    ///
    /// # Arguments
    /// * `delay_s`: by how much stamps of images are late: believed, true.
    pub fn of(believed: &CalibratedCamera, truth: &CalibratedCamera, delay_s: (f64, f64)) -> Self {
        let focal = |k: usize| (believed.camera.focal[k] / truth.camera.focal[k] - 1.0).abs();
        let (pose, true_pose) = (&believed.imu_from_camera, &truth.imu_from_camera);
        Self {
            deg: pose.rotation.angle_to(&true_pose.rotation).to_degrees(),
            m: (pose.translation - true_pose.translation).norm(),
            seconds: delay_s.0 - delay_s.1,
            focal_fraction: focal(0).max(focal(1)),
        }
    }
}
