//! A pose by the map beside that of odometry, and how far two of them are from one motion.

use crate::map_update::map_fix::{odometry_error, worst_sigmas};
use geometry::{Pose, PoseWithCovariance};

/// Tolerance of two fixes in their standard deviations.
const SIGMAS: f64 = 3.0;
/// Error of odometry by the distance moved: ten times that of a working one, as it is not calibrated at its start.
const DRIFT_FRACTION: f64 = 0.02;
/// The same of its rotation, rad/m.
const DRIFT_RAD_M: f64 = 0.002;

/// A pose in G, and how uncertain it is.
#[derive(Clone, Copy, Debug)]
pub struct FixedPose {
    /// Pose of the IMU in G.
    pub global_from_imu: Pose,
    /// Pose of the IMU in L by odometry.
    pub local_from_imu: Pose,
    /// Standard deviation of the rotation, rad.
    pub sigma_rotation: f64,
    /// Standard deviation of the position, metres.
    pub sigma_position: f64,
}

impl FixedPose {
    /// A pose in G with a covariance, at a pose in L; standard deviations are those of its worst axis.
    pub fn new(global_from_imu: &PoseWithCovariance, local_from_imu: &Pose) -> Self {
        let (sigma_rotation, sigma_position) = worst_sigmas(&global_from_imu.covariance);
        Self {
            global_from_imu: global_from_imu.pose,
            local_from_imu: *local_from_imu,
            sigma_rotation,
            sigma_position,
        }
    }

    /// The standard deviation of the position that is predicted from it for a later one, metres.
    pub(super) fn sigma_predicted(&self, later: &Self) -> f64 {
        let distance = (later.local_from_imu.translation - self.local_from_imu.translation).norm();
        // An error of its rotation displaces the later one.
        self.sigma_position.hypot(self.sigma_rotation * distance)
    }

    /// Whether the motion between two fixes is that of odometry.
    pub(super) fn agrees(&self, before: &Self) -> bool {
        self.apart(before).iter().all(|apart| *apart <= SIGMAS)
    }

    /// How far the motion between two fixes is from that of odometry, rotation and translation, in standard deviations.
    pub(super) fn apart(&self, before: &Self) -> [f64; 2] {
        let moved = before.local_from_imu.inverse() * self.local_from_imu;
        let (turned, shifted) = odometry_error(&before.global_from_imu, &moved, &self.global_from_imu);
        let distance = moved.translation.norm();
        let sigma_rotation = self.sigma_rotation.hypot(before.sigma_rotation);
        let sigma_position = self.sigma_position.hypot(before.sigma_predicted(self));
        [
            turned / (sigma_rotation + DRIFT_RAD_M / SIGMAS * distance),
            shifted / (sigma_position + DRIFT_FRACTION / SIGMAS * distance),
        ]
    }

    /// The same with the drift of odometry.
    pub(super) fn sigma_with_drift(&self, later: &Self) -> f64 {
        let distance = (later.local_from_imu.translation - self.local_from_imu.translation).norm();
        self.sigma_predicted(later) + DRIFT_FRACTION / SIGMAS * distance
    }
}
