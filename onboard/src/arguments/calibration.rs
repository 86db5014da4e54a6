//! Calibration files and topics of a recording.

use super::INPUT;
use clap::Args;
use sensors::CalibrationFiles;
use std::path::PathBuf;

/// Calibration files, in place of the recording's own, and the topics of a bag.
#[derive(Args, Clone, Debug, Default)]
pub struct CalibrationArguments {
    /// Kalibr's camchain-imucam.yaml [default: the recording's sensor.yaml files, else a camera chain in its folder]
    ///
    /// Also a folder with it, or one in the EuRoC layout. Where a bag has the CameraInfo of its
    /// cameras, the file may leave their intrinsics out.
    #[arg(long, value_name = "YAML|DIR", help_heading = INPUT)]
    pub calibration: Option<PathBuf>,
    /// Kalibr's imu.yaml [default: the recording's imu0/sensor.yaml, else an imu.yaml in its folder]
    #[arg(long, value_name = "YAML", help_heading = INPUT)]
    pub imu_calibration: Option<PathBuf>,
    /// Topic of the IMU: in a bag [default: the only sensor_msgs/Imu], or with --source ros2
    #[arg(long, value_name = "TOPIC", help_heading = INPUT)]
    pub imu_topic: Option<String>,
    /// Topic of a camera, once for each: in a bag [default: those with images, in order of their names], or with --source ros2
    #[arg(long, value_name = "TOPIC", help_heading = INPUT)]
    pub camera_topic: Vec<String>,
}

impl CalibrationArguments {
    /// The files and topics.
    pub fn files(&self) -> CalibrationFiles {
        let mut files = CalibrationFiles::default();
        files.cameras.clone_from(&self.calibration);
        files.imu.clone_from(&self.imu_calibration);
        files.imu_topic.clone_from(&self.imu_topic);
        files.camera_topics.clone_from(&self.camera_topic);
        files
    }
}
