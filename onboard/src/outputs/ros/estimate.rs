//! What is published of one image.

use estimator::{Estimator, Motion, Status};
use geometry::{Pose, PoseWithCovariance};

/// What is published of one image.
#[derive(Clone, Debug)]
pub struct Estimate {
    /// Motion in L.
    pub motion: Motion,
    /// Pose in G and that of L, where localized.
    pub global: Option<GlobalEstimate>,
}

/// An [`Estimate`] in the map.
#[derive(Clone, Debug)]
pub struct GlobalEstimate {
    /// Pose in G.
    pub global_from_imu: PoseWithCovariance,
    /// Pose of L in G.
    pub global_from_local: Pose,
}

impl Estimate {
    /// The estimate of now. A robot that is lost has no pose in the map.
    pub fn of(estimator: &Estimator, status: &Status) -> Self {
        let poses = estimator.global_from_imu().zip(estimator.global_from_local());
        let trusted = poses.filter(|_| status.localization.is_usable());
        Self {
            motion: estimator.motion(),
            global: trusted.map(|(global_from_imu, global_from_local)| GlobalEstimate {
                global_from_imu,
                global_from_local: global_from_local.pose,
            }),
        }
    }
}
