//! What a run reads: events of a sensor source, read ahead as far as the estimator needs them.

mod imu_window;
mod sensor_queue;

pub(crate) use imu_window::ImuWindow;
pub(crate) use sensor_queue::{NextFrame, SensorQueue};
