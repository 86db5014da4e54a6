//! The unknowns of an adjustment.

use geometry::pose::Pose;
use nalgebra::{DVector, SVector, Vector3};

use crate::camera::ViewPose;
use crate::landmark::InverseDepthLandmark;
use crate::layout::{MOTION, POSE, StateLayout};

/// Velocity and biases of a view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewMotion {
    /// Velocity of the IMU in G (m/s).
    pub velocity: Vector3<f64>,
    /// Bias of the gyroscope (rad/s).
    pub gyroscope_bias: Vector3<f64>,
    /// Bias of the accelerometer (m/s^2).
    pub accelerometer_bias: Vector3<f64>,
}

impl ViewMotion {
    /// Adds an error `[δv, δb_g, δb_a]`.
    pub fn retract(&self, error: &SVector<f64, MOTION>) -> ViewMotion {
        ViewMotion {
            velocity: self.velocity + error.fixed_rows::<3>(0),
            gyroscope_bias: self.gyroscope_bias + error.fixed_rows::<3>(3),
            accelerometer_bias: self.accelerometer_bias + error.fixed_rows::<3>(6),
        }
    }

    /// As one vector, in the order of its error.
    pub fn vector(&self) -> SVector<f64, MOTION> {
        let mut vector = SVector::<f64, MOTION>::zeros();
        vector.fixed_rows_mut::<3>(0).copy_from(&self.velocity);
        vector.fixed_rows_mut::<3>(3).copy_from(&self.gyroscope_bias);
        vector.fixed_rows_mut::<3>(6).copy_from(&self.accelerometer_bias);
        vector
    }
}

/// The estimated states and landmarks.
#[derive(Clone, Debug, Default)]
pub struct Bundle {
    /// `global_from_body` of each view.
    pub poses: Vec<Pose>,
    /// Velocity and biases of the first views; empty without an IMU.
    pub motions: Vec<ViewMotion>,
    /// All landmarks.
    pub landmarks: Vec<InverseDepthLandmark>,
}

impl Bundle {
    /// The poses with rotation matrices.
    pub fn view_poses(&self) -> Vec<ViewPose> {
        self.poses.iter().map(ViewPose::from).collect()
    }

    /// The layout of the states.
    pub fn layout(&self) -> StateLayout {
        StateLayout { views: self.poses.len(), motions: self.motions.len() }
    }

    /// The bundle moved by an error of its states.
    ///
    /// # Arguments
    /// * `error`: as its layout says.
    pub fn moved(&self, error: &DVector<f64>) -> Bundle {
        let layout = self.layout();
        let pose = |(view, pose): (usize, &Pose)| {
            pose.retract(&error.fixed_rows::<POSE>(layout.pose(view).start).into_owned())
        };
        let motion = |(view, motion): (usize, &ViewMotion)| {
            motion.retract(&error.fixed_rows::<MOTION>(layout.motion(view).start).into_owned())
        };
        Bundle {
            poses: self.poses.iter().enumerate().map(pose).collect(),
            motions: self.motions.iter().enumerate().map(motion).collect(),
            landmarks: self.landmarks.clone(),
        }
    }
}
