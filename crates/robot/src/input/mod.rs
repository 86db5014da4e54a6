//! What a run reads: events of a sensor source, read ahead as far as the estimator needs them.

mod bad_readings;
mod imu_window;
mod sensor_faults;
mod sensor_queue;

pub(crate) use sensor_faults::{SensorFault, SensorFaults};
pub(crate) use sensor_queue::{NextFrame, SensorQueue};
