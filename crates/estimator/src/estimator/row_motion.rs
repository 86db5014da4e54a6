//! Motion about the images of cameras with a rolling shutter or a delay, from the readings of the IMU.

use super::Estimator;
use super::time_update::IMU_SLACK_NS;
use crate::rolling_shutter::motion_around::{MotionAround, TimedPoses, poses_from};
use nalgebra::Vector3;
use std::sync::Arc;
use types::ImuSample;

impl Estimator {
    /// Whether pixels have times of their own; without, nothing here is called.
    pub(super) fn has_pixel_times(&self) -> bool {
        self.state.calibration.has_pixel_times()
    }

    /// The readings since the newest image are those after it: before they are integrated.
    pub(super) fn note_motion_after(&mut self, readings: &[ImuSample]) {
        let reach_ns = self.state.calibration.row_reach_ns();
        let from_ns = self.state.stamp_ns;
        let after = poses_from(
            &self.state.imu,
            readings.iter().take_while(|reading| reading.stamp_ns - from_ns <= reach_ns),
            &self.gravity(),
        );
        if let Some(newest) = self.state.clones.last_mut()
            && let Some(motion) = &newest.motion
            && !after.is_empty()
        {
            newest.motion = Some(Arc::new(motion.followed_by(&after)));
        }
    }

    /// The motion before the state, after the readings were integrated.
    pub(super) fn motion_before(&self, readings: &[ImuSample]) -> TimedPoses {
        let reach_ns = self.state.calibration.row_reach_ns();
        let to_ns = self.state.stamp_ns;
        poses_from(
            &self.state.imu,
            readings.iter().rev().take_while(|reading| to_ns - reading.stamp_ns <= reach_ns),
            &self.gravity(),
        )
    }

    /// The motion about the state, which is to be cloned. After it, the readings that have come already, and their last one on.
    ///
    /// # Arguments
    /// * `stamp_ns`: of the image.
    pub(super) fn motion_around(&self, stamp_ns: i64, before: &TimedPoses) -> Arc<MotionAround> {
        let reach_ns = self.state.calibration.row_reach_ns();
        let from_ns = self.state.stamp_ns;
        let readings = self.imu.interval(from_ns, from_ns + reach_ns, reach_ns + IMU_SLACK_NS);
        let after = readings
            .map(|readings| poses_from(&self.state.imu, readings.iter(), &self.gravity()))
            .unwrap_or_default();
        let since_before = self.state.clones.last().map(|last| {
            let seconds = (stamp_ns - last.stamp_ns) as f64 * 1e-9;
            (seconds, last.local_from_imu.inverse() * self.state.imu.local_from_imu)
        });
        Arc::new(MotionAround::new(before, &after, since_before))
    }

    fn gravity(&self) -> Vector3<f64> {
        -Vector3::z() * self.config.gravity
    }
}
