//! Calibration errors: the calibration that the filter is given, beside the true one.
//!
//! Both cameras are rotated and moved on the body as one rigid rig, and both focal lengths have the same relative error:
//! what was calibrated together is wrong together. The magnitudes are the same in every run; directions and signs are
//! random.

use crate::random::{Purpose, normal, normal3, stream};
use estimator::CalibratedCamera;
use geometry::{Pose, rotation};
use nalgebra::Vector3;
use serde::Serialize;

/// Magnitudes of the errors of the stated calibration.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CalibrationErrors {
    /// Rotation of the cameras on the body, rad.
    pub rotation_rad: f64,
    /// Translation of the cameras on the body, metres.
    pub translation_m: f64,
    /// Error of the stamps of images, seconds.
    pub time_offset_s: f64,
    /// Relative error of the focal lengths.
    pub focal_fraction: f64,
}

/// The calibration that a filter is given in one run.
#[derive(Clone, Debug)]
pub(crate) struct Stated {
    /// The cameras.
    pub(crate) rig: Vec<CalibratedCamera>,
    /// What is added to the true time of an image, nanoseconds.
    pub(crate) image_delay_ns: i64,
}

impl CalibrationErrors {
    /// Samples directions and signs for one run.
    pub(crate) fn draw(&self, seed: u64, truth: &[CalibratedCamera]) -> Stated {
        let mut rng = stream(seed, 1, Purpose::Calibration);
        let turn = direction(normal3(&mut rng)) * self.rotation_rad;
        let shift = direction(normal3(&mut rng)) * self.translation_m;
        let mut sign = || normal(&mut rng).signum();
        let (delay, longer) = (sign() * self.time_offset_s, 1.0 + sign() * self.focal_fraction);
        let stated = |camera: &CalibratedCamera| {
            let mut stated = camera.clone();
            stated.imu_from_camera = Pose::new(
                rotation::exp(&turn) * camera.imu_from_camera.rotation,
                camera.imu_from_camera.translation + shift,
            );
            stated.camera.focal = camera.camera.focal.map(|focal| focal * longer);
            stated
        };
        Stated { rig: truth.iter().map(stated).collect(), image_delay_ns: (delay * 1e9).round() as i64 }
    }
}

fn direction(drawn: Vector3<f64>) -> Vector3<f64> {
    drawn.try_normalize(1e-9).unwrap_or_else(Vector3::x)
}

/// Error of one camera's calibration.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct CalibrationError {
    /// Rotation, degrees.
    pub deg: f64,
    /// Position on the body, metres.
    pub m: f64,
    /// Delay of the images, seconds: estimated minus true.
    pub seconds: f64,
    /// Relative error of the focal length, the larger of both axes.
    pub focal_fraction: f64,
}

impl CalibrationError {
    /// The error of an estimated or stated calibration.
    ///
    /// # Arguments
    /// * `delay_s`: delay of the stamps of images, seconds: estimated, true.
    pub fn of(estimate: &CalibratedCamera, truth: &CalibratedCamera, delay_s: (f64, f64)) -> Self {
        let focal = |k: usize| (estimate.camera.focal[k] / truth.camera.focal[k] - 1.0).abs();
        let (pose, true_pose) = (&estimate.imu_from_camera, &truth.imu_from_camera);
        Self {
            deg: pose.rotation.angle_to(&true_pose.rotation).to_degrees(),
            m: (pose.translation - true_pose.translation).norm(),
            seconds: delay_s.0 - delay_s.1,
            focal_fraction: focal(0).max(focal(1)),
        }
    }
}
