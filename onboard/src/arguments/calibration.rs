//! Calibration files of a recording.

use super::INPUT;
use clap::Args;
use sensors::CalibrationFiles;
use std::path::PathBuf;

/// Calibration files, in place of the recording's own.
#[derive(Args, Clone, Debug, Default)]
pub struct CalibrationArguments {
    /// Kalibr's camchain-imucam.yaml; for live sensors also a folder with it, or one in the EuRoC layout [default: the
    /// recording's sensor.yaml files, else a camera chain in its folder]
    #[arg(long, value_name = "YAML_OR_DIR", help_heading = INPUT)]
    pub calibration: Option<PathBuf>,
    /// Kalibr's imu.yaml [default: the recording's imu0/sensor.yaml, else an imu.yaml in its folder]
    #[arg(long, value_name = "YAML", help_heading = INPUT)]
    pub imu_calibration: Option<PathBuf>,
}

impl CalibrationArguments {
    /// The files.
    pub fn files(&self) -> CalibrationFiles {
        let mut files = CalibrationFiles::default();
        files.cameras.clone_from(&self.calibration);
        files.imu.clone_from(&self.imu_calibration);
        files
    }
}
