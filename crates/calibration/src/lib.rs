//! Calibrations of the sensors of a robot, and the files in which they are written.
//!
//! | module | what |
//! |---|---|
//! | `sensors` | [`SensorCalibration`]: [`ImuSensor`], [`CameraSensor`], [`WheelSensor`] and [`GnssSensor`] |
//! | `imu_intrinsics` | [`ImuIntrinsics`]: scale, misalignment and g-sensitivity |
//! | [`sensor_yaml`] | `sensor.yaml` of the EuRoC layout |
//! | [`wheel_yaml`] | `sensor.yaml` of the wheels |
//! | [`numbers`] | numbers as text that reads back exactly |
//! | [`kalibr`] | Kalibr's camera chain and `imu.yaml`, and what OpenVINS, ORB-SLAM3, Basalt and Kimera write |
//!
//! `imu_from_camera` takes points in the frame of a camera (x right, y down, z forward) to that of the IMU. Noise densities are
//! those of continuous time, as in Kalibr's files. What no camera has (a focal length of 1e308, a mount 1,000 km away) is refused.

#![cfg_attr(test, allow(clippy::unwrap_used))]

mod error;
mod imu_intrinsics;
pub mod kalibr;
mod mount;
mod noise_check;
pub mod numbers;
pub mod sensor_yaml;
mod sensors;
pub mod wheel_yaml;
mod yaml;

pub use error::CalibrationError;
pub use imu_intrinsics::ImuIntrinsics;
pub use sensor_yaml::{lens_of_text, read_lens};
pub use sensors::{
    CameraSensor, GnssSensor, ImuSensor, SensorCalibration, WheelSensor, camera_groups, relative_time_shifts,
};
pub use yaml::{Lens, projection_yaml};
