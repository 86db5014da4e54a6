//! The latest of what a robot published, as a VDA 5050 vehicle.

use crate::messages::{AgvPosition, Velocity};
use crate::quality::{deviation_range_m, localization_score};
use geometry::{Pose, PoseWithCovariance, tilt_beyond_limit_deg};
use nalgebra::Vector3;
use protocol::{Presence, Published, RobotOdometry, RobotPose, RobotState, RobotStatus};
use std::time::{Duration, Instant};

/// How a vehicle is described.
#[derive(Clone, Debug, PartialEq)]
pub struct VehicleSettings {
    /// The vehicle's reference point and axes (x forward, y left, z up) in its IMU's frame.
    pub imu_from_base: Pose,
    /// Tolerance of [`localization_score`], metres.
    pub tolerance_m: f64,
    /// Poses and velocities that are older are not valid any more.
    pub max_age: Duration,
}

impl Default for VehicleSettings {
    fn default() -> Self {
        Self { imu_from_base: Pose::identity(), tolerance_m: 0.1, max_age: Duration::from_secs(1) }
    }
}

/// Something with the time at which it came.
#[derive(Clone, Debug)]
struct Received<T> {
    value: T,
    at: Instant,
}

/// The latest of what a robot published. Times are those at which messages came, since the clocks of sensors are their own.
///
/// ```
/// use std::time::Instant;
/// use vda5050::{Vehicle, VehicleSettings};
///
/// let vehicle = Vehicle::new(VehicleSettings::default(), Instant::now());
/// let position = vehicle.position(Instant::now());
/// assert!(!position.position_initialized && position.localization_score == Some(0.0));
/// ```
#[derive(Clone, Debug)]
pub struct Vehicle {
    settings: VehicleSettings,
    pose: Option<Received<RobotPose>>,
    /// Whether the robot was there and localized ever since the pose came.
    is_pose_valid: bool,
    odometry: Option<Received<RobotOdometry>>,
    status: Option<RobotStatus>,
    presence: Presence,
    /// Whether anything was heard of it.
    is_heard: bool,
}

impl Vehicle {
    /// A robot that was heard of for the first time.
    pub fn new(settings: VehicleSettings, now: Instant) -> Self {
        Self {
            settings,
            pose: None,
            is_pose_valid: false,
            odometry: None,
            status: None,
            presence: Presence::new(now),
            is_heard: true,
        }
    }

    /// A robot that nothing was heard of yet: it is not there.
    pub(crate) fn expected(settings: VehicleSettings, now: Instant) -> Self {
        Self { is_heard: false, ..Self::new(settings, now) }
    }

    /// Whether anything was heard of it.
    pub(crate) fn is_heard(&self) -> bool {
        self.is_heard
    }

    /// Notes a message of the robot.
    ///
    /// # Arguments
    /// * `now`: when it came.
    pub fn note(&mut self, published: Published, now: Instant) {
        self.is_heard = true;
        self.presence.note_published(&published, now);
        match published {
            Published::Pose(pose) => {
                let is_repeated = self.pose.as_ref().is_some_and(|last| last.value.stamp_ns == pose.stamp_ns);
                if !is_repeated {
                    self.pose = Some(Received { value: *pose, at: now });
                    self.is_pose_valid = !self.presence.has_ended();
                }
            }
            Published::Odometry(odometry) => {
                let stamp_ns = odometry.stamp_ns;
                if self.odometry.as_ref().is_none_or(|last| last.value.stamp_ns != stamp_ns) {
                    self.odometry = Some(Received { value: *odometry, at: now });
                }
            }
            Published::Status(status) => {
                self.is_pose_valid &= status.state == RobotState::Localized;
                self.status = Some(status);
            }
        }
    }

    /// Notes that the robot's liveliness token came or went.
    pub fn note_token(&mut self, is_there: bool, now: Instant) {
        self.is_heard |= is_there;
        self.presence.note_token(is_there, now);
        self.is_pose_valid &= is_there;
    }

    /// Whether the robot is there: it has a token, and published something in the last 5 s.
    pub fn is_online(&self, now: Instant) -> bool {
        self.is_heard && self.presence.is_online(now)
    }

    /// Whether the robot's session ended: its token went, or it shut down.
    pub fn has_ended(&self) -> bool {
        self.presence.has_ended()
    }

    /// Whether the robot shut down in order, and said so.
    pub fn is_off(&self) -> bool {
        self.presence.is_off()
    }

    /// Where the vehicle is in its map.
    ///
    /// The position is initialized where the robot is there, localized, and published a pose within
    /// [`VehicleSettings::max_age`] in a map whose z axis is vertical ([`Vehicle::map_tilt`]). Where it is not, x, y and theta are the last
    /// known ones, with a score of 0 and no range.
    ///
    /// # Returns
    /// x and y in the map's frame, and the yaw of the vehicle's axes in it.
    pub fn position(&self, now: Instant) -> AgvPosition {
        let known = self.pose.as_ref();
        let is_valid = self.is_pose_valid
            && self.is_online(now)
            && self.status.as_ref().is_some_and(|status| status.state == RobotState::Localized)
            && known.is_some_and(|pose| now.duration_since(pose.at) <= self.settings.max_age)
            && self.map_tilt().is_none();
        let global_from_base: Option<PoseWithCovariance> =
            known.map(|pose| pose.value.global_from_imu.change_of_child(&self.settings.imu_from_base));
        let (x, y, theta) = global_from_base.as_ref().map_or((0.0, 0.0, 0.0), |base| {
            let forward = base.pose.rotation * Vector3::x();
            (base.pose.translation.x, base.pose.translation.y, forward.y.atan2(forward.x))
        });
        let valid = global_from_base.as_ref().filter(|_| is_valid);
        let of_status = || self.status.as_ref().and_then(|status| status.map.clone());
        AgvPosition {
            position_initialized: is_valid,
            localization_score: Some(
                valid.map_or(0.0, |base| localization_score(base, self.settings.tolerance_m)),
            ),
            deviation_range: valid.map(deviation_range_m),
            x,
            y,
            theta,
            map_id: known.map(|pose| pose.value.map.clone()).or_else(of_status).unwrap_or_default(),
        }
    }

    /// The map whose z axis is not vertical, by the last pose in it, and the angle between them, degrees; `None` within 5 degrees. x, y and
    /// yaw in such a map are not those on the floor.
    pub fn map_tilt(&self) -> Option<(&str, f64)> {
        let pose = &self.pose.as_ref()?.value;
        // z of the odometry frame is up.
        let up_in_global = pose.global_from_local.pose.rotation * Vector3::z();
        Some((pose.map.as_str(), tilt_beyond_limit_deg(&up_in_global)?))
    }

    /// How the vehicle moves, in its own axes; `None` without odometry of the last [`VehicleSettings::max_age`], or while the robot is lost.
    pub fn velocity(&self, now: Instant) -> Option<Velocity> {
        let is_lost = self.status.as_ref().is_some_and(|status| status.state == RobotState::Lost);
        let is_fresh =
            |odometry: &&Received<RobotOdometry>| now.duration_since(odometry.at) <= self.settings.max_age;
        let odometry =
            &self.odometry.as_ref().filter(is_fresh).filter(|_| !is_lost && self.is_online(now))?.value;
        let imu_from_base = &self.settings.imu_from_base;
        let angular_in_imu = Vector3::from(odometry.angular_velocity_in_imu);
        let imu_from_local = odometry.local_from_imu.pose.rotation.inverse();
        let of_imu = imu_from_local * Vector3::from(odometry.velocity_in_local);
        let of_base = of_imu + angular_in_imu.cross(&imu_from_base.translation);
        let base_from_imu = imu_from_base.rotation.inverse();
        let (linear, angular) = (base_from_imu * of_base, base_from_imu * angular_in_imu);
        Some(Velocity { vx: linear.x, vy: linear.y, omega: angular.z })
    }
}
