//! Calibration files and topics of a recording.

use super::INPUT;
use clap::Args;
use sensors::{CalibrationFiles, ImuUnits};
use std::path::PathBuf;

/// Units of accelerometers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum AccelerometerUnit {
    /// m/s^2.
    #[value(name = "m/s2")]
    MetresPerSecondSquared,
    /// Standard gravity, 9.80665 m/s^2.
    #[value(name = "g")]
    G,
}

/// Units of gyroscopes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum GyroscopeUnit {
    /// rad/s.
    #[value(name = "rad/s")]
    RadiansPerSecond,
    /// deg/s.
    #[value(name = "deg/s")]
    DegreesPerSecond,
}

/// Calibration files, in place of the recording's own, the topics of a bag, and which images make a pair.
#[derive(Args, Clone, Debug, Default)]
pub struct CalibrationArguments {
    /// Kalibr's camchain-imucam.yaml [default: the recording's sensor.yaml files, else a camera chain in its folder, else of a bag its
    /// CameraInfo and /tf_static]
    ///
    /// Also a folder with it, or one in the EuRoC layout, and files of OpenVINS, Kimera, ORB-SLAM3 and Basalt. Where a bag has the CameraInfo of its
    /// cameras, the file may leave their intrinsics out.
    #[arg(long, value_name = "YAML|DIR", help_heading = INPUT)]
    pub calibration: Option<PathBuf>,
    /// Kalibr's imu.yaml [default: the recording's imu0/sensor.yaml, else an imu.yaml in its folder, else what --record-sensors wrote]
    #[arg(long, value_name = "YAML", help_heading = INPUT)]
    pub imu_calibration: Option<PathBuf>,
    /// Topic of the IMU, or of its gyroscope: in a bag [default: the only sensor_msgs/Imu], or with --source ros2
    #[arg(long, value_name = "TOPIC", help_heading = INPUT)]
    pub imu_topic: Option<String>,
    /// Topic of the accelerometer, where it is not that of the gyroscope: in a bag [default: the only one without angular
    /// velocities], or with --source ros2
    ///
    /// Its values are interpolated to the times of the gyroscope.
    #[arg(long, value_name = "TOPIC", help_heading = INPUT)]
    pub accelerometer_topic: Option<String>,
    /// Unit of the accelerometer as it is recorded, or comes [default: m/s2]
    #[arg(long, value_enum, value_name = "UNIT", help_heading = INPUT)]
    pub accelerometer_unit: Option<AccelerometerUnit>,
    /// Unit of the gyroscope as it is recorded, or comes [default: rad/s]
    #[arg(long, value_enum, value_name = "UNIT", help_heading = INPUT)]
    pub gyroscope_unit: Option<GyroscopeUnit>,
    /// Topic of a camera, once for each: in a bag [default: those that the calibration names as rostopic, else those with images,
    /// in order of their names], or with --source ros2
    #[arg(long, value_name = "TOPIC", help_heading = INPUT)]
    pub camera_topic: Vec<String>,
    /// Largest difference between the stamps of the two images of a stereo pair, milliseconds: recorded or live [default: 5]
    ///
    /// Each image is paired with the nearest one of the other camera. A lone image of camera 0 is used as that of one
    /// camera, one of camera 1 is left out; how many there are is in the log and in summary.json.
    #[arg(long, value_name = "MS", value_parser = tolerance_ms, help_heading = INPUT)]
    pub pair_tolerance_ms: Option<f64>,
}

/// Parses a difference between two stamps.
fn tolerance_ms(text: &str) -> anyhow::Result<f64> {
    let tolerance: f64 = text.parse()?;
    anyhow::ensure!((0.0..=1000.0).contains(&tolerance), "it must be from 0 to 1000 ms");
    Ok(tolerance)
}

impl CalibrationArguments {
    /// The files and topics.
    pub fn files(&self) -> CalibrationFiles {
        let mut files = CalibrationFiles::default();
        files.cameras.clone_from(&self.calibration);
        files.imu.clone_from(&self.imu_calibration);
        files.imu_topic.clone_from(&self.imu_topic);
        files.accelerometer_topic.clone_from(&self.accelerometer_topic);
        files.camera_topics.clone_from(&self.camera_topic);
        files.pair_tolerance_ns = self.pair_tolerance_ns();
        files.imu_units = self.imu_units();
        files
    }

    /// The units of the IMU's readings.
    pub fn imu_units(&self) -> ImuUnits {
        ImuUnits {
            accelerations_in_g: self.accelerometer_unit == Some(AccelerometerUnit::G),
            rates_in_degrees: self.gyroscope_unit == Some(GyroscopeUnit::DegreesPerSecond),
        }
    }

    /// The largest difference between the stamps of a stereo pair, where it is given, nanoseconds.
    pub fn pair_tolerance_ns(&self) -> Option<i64> {
        self.pair_tolerance_ms.map(|tolerance| (tolerance * 1e6).round() as i64)
    }
}
