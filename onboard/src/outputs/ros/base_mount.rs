//! Where the robot's frame is on its IMU, which transforms may state late.

use geometry::Pose;
use std::sync::{Arc, PoisonError, RwLock};

/// The pose of the robot's frame in the IMU's, the same one for all that publish poses of the robot.
#[derive(Clone, Debug)]
pub struct BaseMount(Arc<RwLock<Mounted>>);

#[derive(Clone, Copy, Debug)]
struct Mounted {
    imu_from_base: Pose,
    is_assumed: bool,
}

impl BaseMount {
    /// A robot whose frame is known.
    pub fn known(imu_from_base: Pose) -> Self {
        Self(Arc::new(RwLock::new(Mounted { imu_from_base, is_assumed: false })))
    }

    /// A robot whose frame is taken for that of its IMU until it is [`BaseMount::state`]d.
    pub fn assumed() -> Self {
        Self(Arc::new(RwLock::new(Mounted { imu_from_base: Pose::identity(), is_assumed: true })))
    }

    /// The pose of the robot's frame in the IMU's.
    pub fn imu_from_base(&self) -> Pose {
        self.mounted().imu_from_base
    }

    /// Whether nobody has stated it.
    pub fn is_assumed(&self) -> bool {
        self.mounted().is_assumed
    }

    /// What is published from now on is the pose of this frame.
    pub fn state(&self, imu_from_base: Pose) {
        let stated = Mounted { imu_from_base, is_assumed: false };
        *self.0.write().unwrap_or_else(PoisonError::into_inner) = stated;
    }

    fn mounted(&self) -> Mounted {
        *self.0.read().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Default for BaseMount {
    /// The robot's frame is that of the IMU.
    fn default() -> Self {
        Self::known(Pose::identity())
    }
}
