//! What a robot gives out of one image: where it is, and how it is.

use super::counts::QuerySummary;
use super::map_conversion::map_identity;
use estimator::{Estimator, Localization, Motion, Status};
use geometry::PoseWithCovariance;
use protocol::MapIdentity;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Where the robot is at the time of an image.
///
/// Times are those of the estimator: see [`Output::set_clock_shift`](crate::Output::set_clock_shift).
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Estimate {
    /// Pose, velocity and biases in the odometry frame L, with their covariance.
    pub motion: Motion,
    /// The poses in the map, from when they were known well enough first. [`Estimate::trusted`] are those to be believed.
    pub global: Option<GlobalEstimate>,
    /// Version of the map that the held keyframes belong to.
    pub map_version: Option<u64>,
    /// Identity of the map that the held keyframes belong to.
    pub map_identity: Option<MapIdentity>,
    /// Whether the robot knows its pose: not lost, and initialized.
    pub is_usable: bool,
    /// Computing time of the image, map updates included and waiting excluded; zero of one that replaces another.
    pub computing_time: Duration,
}

/// The poses of an [`Estimate`] in the map.
#[derive(Clone, Copy, Debug)]
pub struct GlobalEstimate {
    /// Pose of the IMU in the map G, with the covariance of its error `[δθ, δp]` in G (rad, metres).
    pub global_from_imu: PoseWithCovariance,
    /// Pose of L in G, with its covariance likewise.
    pub global_from_local: PoseWithCovariance,
}

impl Estimate {
    /// An estimate without a map version, whose computing took no time.
    ///
    /// # Arguments
    /// * `is_usable`: whether the robot knows its pose.
    pub fn new(motion: Motion, global: Option<GlobalEstimate>, is_usable: bool) -> Self {
        let (map_version, map_identity, computing_time) = (None, None, Duration::ZERO);
        Self { motion, global, map_version, map_identity, is_usable, computing_time }
    }

    /// The estimate of now.
    pub(crate) fn of(estimator: &Estimator, status: &Status, computing_time: Duration) -> Self {
        let poses = estimator.global_from_imu().zip(estimator.global_from_local());
        let is_known = matches!(status.localization, Localization::Localized | Localization::Lost);
        let global = poses.filter(|_| is_known).map(|(global_from_imu, global_from_local)| GlobalEstimate {
            global_from_imu,
            global_from_local,
        });
        Self {
            motion: estimator.motion(),
            global,
            map_version: estimator.map_version(),
            map_identity: estimator.map_identity().map(map_identity),
            is_usable: status.localization.is_usable(),
            computing_time,
        }
    }

    /// The poses in the map that can be trusted: a robot that is lost has none.
    pub fn trusted(&self) -> Option<&GlobalEstimate> {
        self.global.as_ref().filter(|_| self.is_usable)
    }
}

/// How the robot is.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct StatusReport {
    /// Time of the image on the estimator's clock, or of now where none comes, nanoseconds; `None` before the first image, which tells the time of the
    /// sensors.
    pub stamp_ns: Option<i64>,
    /// Whether the pose can be used, and why.
    pub status: Status,
    /// Images that were processed before this one.
    pub frames: usize,
    /// Queries to the map so far.
    pub queries: QuerySummary,
    /// Whether something is wrong with the sensors, or with what they send; the reason of the status says what.
    pub has_sensor_fault: bool,
}

impl StatusReport {
    /// A status before any query.
    pub fn new(stamp_ns: Option<i64>, status: Status) -> Self {
        Self { stamp_ns, status, frames: 0, queries: QuerySummary::default(), has_sensor_fault: false }
    }

    /// Its time, nanoseconds; before the first image that of this machine, since 1970.
    pub fn stamp_or_now_ns(&self) -> i64 {
        self.stamp_ns.unwrap_or_else(|| {
            let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
            i64::try_from(since_1970.as_nanos()).unwrap_or(i64::MAX)
        })
    }
}
