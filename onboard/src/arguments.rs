//! The robot's switches, shared by `onboard` and `driftless run`.

use super::extraction::FeatureArguments;
use anyhow::{Context as _, Result, bail};
use clap::{Args, Parser, ValueEnum};
use estimator::{EstimatorConfig, MapMode, Relinearization};
use sensors::Recording;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

/// Cameras to use.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Cameras {
    /// Only cam0.
    Mono,
    /// cam0 and cam1.
    Stereo,
}

/// What to do with the map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Mode {
    /// No map: visual-inertial odometry only.
    Odometry,
    /// The best keyframe of each answer (SM in the paper).
    Single,
    /// Several keyframes of each answer (MM in the paper).
    Multi,
    /// Takes the map for exact. Overconfident; for comparison only.
    Mapconst,
}

impl From<Mode> for MapMode {
    fn from(mode: Mode) -> Self {
        match mode {
            Mode::Odometry => Self::Odometry,
            Mode::Single => Self::Single,
            Mode::Multi => Self::Multi,
            Mode::Mapconst => Self::MapConst,
        }
    }
}

/// How the first state is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Init {
    /// Half a second at rest, or a second or two in motion, whichever comes first. Until then there is no pose.
    Auto,
    /// The first half second, which must be at rest.
    Static,
    /// The first row of the ground truth: to compare filters without the errors of a start.
    Truth,
}

/// What can be estimated while running.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Calibrate {
    /// Where each camera sits on the body.
    Extrinsics,
    /// Focal length, centre and distortion of each camera.
    Intrinsics,
    /// How far the cameras' clock is behind the IMU's.
    TimeOffset,
}

/// Switches of the robot.
#[derive(Args, Clone, Debug)]
pub struct RobotArguments {
    /// Cameras to use [default: stereo where the recording has cam1]
    #[arg(long, value_enum)]
    pub cameras: Option<Cameras>,
    /// What to do with the map [default: as the settings file says, else multi]
    #[arg(long, value_enum)]
    pub mode: Option<Mode>,
    /// Never move the linearization point to the PnP solution (switches the paper's R off)
    #[arg(long)]
    pub no_relinearize: bool,
    /// How the first state is found
    ///
    /// In motion, one camera must see the speed or the direction change: at constant velocity nothing tells how fast
    /// it is. A stereo pair starts at any motion. The log and the robot's status say what is waited for.
    #[arg(long, value_enum, default_value = "auto")]
    pub init: Init,
    /// Skip so much of the recording, to try starts from different times
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0)]
    pub start_at: f64,
    /// Play so much of the recording [default: to its end]
    #[arg(long, value_name = "SECONDS")]
    pub duration: Option<f64>,
    /// Folder for trajectories, states, events and summary
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Play the recording at the speed it was made, instead of as fast as possible
    #[arg(long)]
    pub realtime: bool,
    /// Name of this robot on the network
    #[arg(long, default_value = "robot")]
    pub robot: String,
    /// Most keyframes that one answer may bring (with --mode multi or mapconst)
    #[arg(long, value_name = "N", default_value_t = 4)]
    pub max_keyframes: u16,
    /// Seconds to wait for the map's answer to one image
    #[arg(long, value_name = "SECONDS", default_value_t = 2.0)]
    pub deadline: f64,
    /// Images: features of the images of camera 0, for the map
    #[command(flatten)]
    pub features: FeatureArguments,
    /// Seconds between two images that the map is asked about, where features are extracted from images
    #[arg(long, value_name = "SECONDS", default_value_t = 0.5)]
    pub query_interval: f64,
    /// Points to follow in images, where the recording has no tracks.csv
    #[arg(long, value_name = "N", default_value_t = 200)]
    pub points: usize,
    /// YAML file with settings of the estimator
    ///
    /// What it names wins over the sensor's file (noise, gravity) and over defaults; switches that are given, --mode
    /// too, win over it.
    #[arg(long, value_name = "FILE")]
    pub estimator_config: Option<PathBuf>,
    /// Factor on the IMU's white noise as its sensor.yaml states it (real sensors on vehicles: about 3)
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    pub imu_noise_scale: f64,
    /// Noise of tracked pixels, px
    #[arg(long, value_name = "PX")]
    pub sigma_track: Option<f64>,
    /// Noise of matched pixels in the robot's image, px
    #[arg(long, value_name = "PX")]
    pub sigma_match: Option<f64>,
    /// Noise of the map's pixels, px [default: what the map says]
    #[arg(long, value_name = "PX")]
    pub sigma_map: Option<f64>,
    /// Initial standard deviation of the gyroscope bias, rad/s
    #[arg(long, value_name = "RAD/S")]
    pub sigma_gyroscope_bias: Option<f64>,
    /// Initial standard deviation of the accelerometer bias, m/s^2
    #[arg(long, value_name = "M/S2")]
    pub sigma_accelerometer_bias: Option<f64>,
    /// Clones in the sliding window
    #[arg(long, value_name = "N")]
    pub window: Option<usize>,
    /// Most landmarks kept in the state; 0 is the plain MSCKF
    #[arg(long, value_name = "N")]
    pub slam_features: Option<usize>,
    /// What of the cameras' calibration to estimate while running (several: separate them by commas)
    #[arg(long, value_enum, value_delimiter = ',', value_name = "WHAT")]
    pub calibrate: Vec<Calibrate>,
}

impl RobotArguments {
    /// All switches at their defaults.
    ///
    /// # Errors
    /// Never in practice: the defaults parse.
    pub fn with_defaults(out: &Path) -> Result<Self> {
        #[derive(Parser)]
        struct Defaults {
            #[command(flatten)]
            robot: RobotArguments,
        }
        let line = [OsStr::new("robot"), OsStr::new("--out"), out.as_os_str()];
        Ok(Defaults::try_parse_from(line)?.robot)
    }

    /// What to do with the map: as the switch says, else as the settings file says.
    ///
    /// # Errors
    /// An unreadable settings file.
    pub fn map_mode(&self) -> Result<MapMode> {
        match (self.mode, &self.estimator_config) {
            (Some(mode), _) => Ok(mode.into()),
            (None, Some(path)) => Ok(read_settings(path, &EstimatorConfig::default())?.mode),
            (None, None) => Ok(EstimatorConfig::default().mode),
        }
    }

    /// The estimator's settings: defaults, then what the sensor's file says, then the settings file, then the switches.
    ///
    /// # Errors
    /// An unreadable settings file, or a setting that cannot work.
    pub fn estimator_config(&self, recording: &Recording<'_>) -> Result<EstimatorConfig> {
        let Some(imu) = &recording.imu else {
            bail!("{} has no IMU (mav0/imu0); a robot needs one", recording.root.display())
        };
        let defaults = EstimatorConfig::default();
        let gravity = imu.gravity_magnitude.unwrap_or(defaults.gravity);
        let mut of_sensor = defaults;
        (of_sensor.imu_noise, of_sensor.gravity) = (imu.noise, gravity);
        let mut config = match &self.estimator_config {
            Some(path) => read_settings(path, &of_sensor)?,
            None => of_sensor,
        };
        if !(self.imu_noise_scale.is_finite() && self.imu_noise_scale > 0.0) {
            bail!("--imu-noise-scale is {}; it must be a positive number", self.imu_noise_scale);
        }
        config.imu_noise = config.imu_noise.inflated(self.imu_noise_scale);
        config.mode = self.mode.map_or(config.mode, Into::into);
        if self.no_relinearize {
            config.relinearization = Relinearization::Off;
        }
        let override_with = |target: &mut f64, value: Option<f64>| *target = value.unwrap_or(*target);
        override_with(&mut config.sigma_track_px, self.sigma_track);
        override_with(&mut config.sigma_match_px, self.sigma_match);
        override_with(&mut config.initial.sigma_gyroscope_bias_rad_s, self.sigma_gyroscope_bias);
        override_with(&mut config.initial.sigma_accelerometer_bias_m_s2, self.sigma_accelerometer_bias);
        config.sigma_map_px = self.sigma_map.or(config.sigma_map_px);
        config.window = self.window.unwrap_or(config.window);
        config.slam_features = self.slam_features.unwrap_or(config.slam_features);
        config.calibration.extrinsics |= self.calibrate.contains(&Calibrate::Extrinsics);
        config.calibration.intrinsics |= self.calibrate.contains(&Calibrate::Intrinsics);
        config.calibration.time_offset |= self.calibrate.contains(&Calibrate::TimeOffset);
        config.validate().map_err(|reason| anyhow::anyhow!("the estimator's settings: {reason}"))?;
        Ok(config)
    }

    /// How many cameras of the recording to use.
    ///
    /// # Errors
    /// Stereo is asked for and the recording has one camera.
    pub fn camera_count(&self, recording: &Recording<'_>) -> Result<usize> {
        match self.cameras {
            Some(Cameras::Mono) => Ok(1),
            None => Ok(recording.cameras.len().min(2)),
            Some(Cameras::Stereo) if recording.cameras.len() >= 2 => Ok(2),
            Some(Cameras::Stereo) => {
                bail!("{} has one camera; give it mav0/cam1, or use --cameras mono", recording.root.display())
            }
        }
    }
}

/// Settings of a YAML file; what it leaves out is as in `defaults`.
///
/// # Errors
/// A file that cannot be read, or that is not settings.
pub fn read_settings(path: &Path, defaults: &EstimatorConfig) -> Result<EstimatorConfig> {
    let misunderstood = || format!("settings {} are not understood", path.display());
    let text =
        std::fs::read_to_string(path).with_context(|| format!("cannot read settings {}", path.display()))?;
    let given: serde_json::Value = serde_saphyr::from_str(&text).with_context(misunderstood)?;
    let mut settings = serde_json::to_value(defaults)?;
    overlay(&mut settings, given);
    serde_json::from_value(settings).with_context(misunderstood)
}

/// Replaces what `given` names, field by field.
fn overlay(settings: &mut serde_json::Value, given: serde_json::Value) {
    match (settings, given) {
        (serde_json::Value::Object(fields), serde_json::Value::Object(given)) => {
            for (name, value) in given {
                overlay(fields.entry(name).or_insert(serde_json::Value::Null), value);
            }
        }
        (setting, value) => *setting = value,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use estimator::ImuNoise;
    use sensors::{ImuSensor, Sequence};

    /// A recording whose sensor says a gravity of its own.
    fn recorded() -> Sequence {
        let imu = ImuSensor { noise: ImuNoise::default(), rate_hz: 200.0, gravity_magnitude: Some(9.79) };
        Sequence {
            root: PathBuf::new(),
            imu: Some(imu),
            imu_samples: Vec::new(),
            cameras: Vec::new(),
            frames: Vec::new(),
            groundtruth: None,
            reference_poses: None,
        }
    }

    #[test]
    fn a_switch_wins_over_the_file_and_the_file_over_the_sensor() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("settings.yaml");
        let recorded = recorded();
        let settled = |file: Option<&str>, mode: Option<Mode>| {
            let mut arguments = RobotArguments::with_defaults(folder.path()).unwrap();
            arguments.mode = mode;
            if let Some(text) = file {
                std::fs::write(&path, text).unwrap();
                arguments.estimator_config = Some(path.clone());
            }
            let config = arguments.estimator_config(&(&recorded).into()).unwrap();
            assert_eq!(config.mode, arguments.map_mode().unwrap());
            (config.gravity, config.mode)
        };
        assert_eq!(settled(None, None), (9.79, MapMode::Multi));
        assert_eq!(settled(Some("window: 9"), None), (9.79, MapMode::Multi));
        assert_eq!(settled(Some("gravity: 9.83\nmode: single"), None), (9.83, MapMode::Single));
        assert_eq!(settled(Some("mode: single"), Some(Mode::Mapconst)), (9.79, MapMode::MapConst));
    }
}
