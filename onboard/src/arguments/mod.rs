//! Switches of the robot, shared by `onboard` and `driftless run`.

mod calibration;
mod choices;
mod features;
mod gnss;
mod hand_in;
mod imu_in_base_link;
mod live;
#[cfg(feature = "ros")]
mod ros;
mod settings;
mod settings_file;
mod wheels;

pub use calibration::CalibrationArguments;
pub use choices::{Calibrate, Cameras, FrameKind, Init, Mode, Source, TopicFormat};
pub use features::{DEFAULT_MAX_FEATURES, FeatureArguments, mask_path, read_masks};
pub use gnss::GnssArguments;
pub use hand_in::HandInArguments;
pub use imu_in_base_link::ImuInBaseLink;
pub use live::LiveArguments;
#[cfg(feature = "ros")]
pub use ros::RosArguments;
pub use settings::{SettingsError, read_settings};
pub use settings_file::{SettingsFileError, settings_text, with_settings};
pub use wheels::WheelArguments;

use super::outputs::{BaseMount, RobotMetrics, RosBody, RosOutput};
use anyhow::{Result, bail};
use clap::{Args, Parser};
use estimator::{EstimatorConfig, MapMode, Relinearization};
use nalgebra::Vector3;
use robot::estimator_config;
use robot::initial_pose::InitialPoses;
use sensors::{CalibrationFiles, Contents, Recording, SensorCalibration};
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

/// Heading in `--help` of the switches about the recording.
pub const INPUT: &str = "Input";
/// Heading in `--help` of the switches about map and network.
pub const MAP: &str = "Map and network";
/// Heading in `--help` of the switches about what is written.
pub const OUTPUT: &str = "Output";
/// Name of a robot that was given none.
pub const DEFAULT_ROBOT: &str = "robot";
const ESTIMATOR: &str = "Estimator";
const NOISE: &str = "Noise";

/// Of a robot that runs until somebody stops it, MB: some hours of states at the rate of a camera.
const LIVE_OUT_LIMIT_MB: u32 = 1000;

/// Switches of the robot.
#[derive(Args, Clone, Debug)]
pub struct RobotArguments {
    /// Folder for trajectories, states, events and summary; created if necessary
    #[arg(long, value_name = "DIR", help_heading = OUTPUT)]
    pub out: PathBuf,
    /// Most space of these files, MB: where they reach half of it they are moved to DIR/earlier, in place of what is there, and so is
    /// what an earlier run left [default: 1000 with live sensors, else none]
    #[arg(long, value_name = "MB", value_parser = clap::value_parser!(u32).range(1..), help_heading = OUTPUT)]
    pub out_limit_mb: Option<u32>,

    /// Record poses, odometry, transforms, status and queries in an MCAP file, as messages of ROS 2: for Foxglove, PlotJuggler
    /// and `ros2 bag`
    ///
    /// An older file of this name stays; the new one is then FILE_2.
    #[arg(long, value_name = "FILE", help_heading = OUTPUT)]
    pub record: Option<PathBuf>,
    /// Record readings and images, too: as they came, with CameraInfo, the cameras' poses on /tf_static, and the noise of the IMU
    ///
    /// Such a file can be played again with --sequence, without any other calibration.
    #[arg(long, requires = "record", help_heading = OUTPUT)]
    pub record_sensors: bool,
    /// Sessions for the map
    #[command(flatten)]
    pub hand_in: HandInArguments,
    /// The IMU in base_link, for --record and --ros2: metres and radians (fixed-axis roll, pitch, yaw, as in URDF) [default: by
    /// /tf_static of the bag, or of ROS 2 with --source ros2; else base_link is the IMU]
    #[arg(long, value_name = "X,Y,Z,ROLL,PITCH,YAW", allow_hyphen_values = true, help_heading = OUTPUT)]
    pub imu_in_base_link: Option<ImuInBaseLink>,
    /// The robot's frames, for --record
    #[arg(skip)]
    pub body: RosBody,

    /// What the run counts; shared with whoever clones it before the run
    #[arg(skip)]
    pub metrics: RobotMetrics,
    /// Where an operator sets poses
    #[arg(skip)]
    pub initial_poses: InitialPoses,
    /// Topics for ROS 2, where there are any
    #[arg(skip)]
    pub ros: Option<RosOutput>,
    /// Direction of gravity in the map, where it was built without reference poses: its frame is not that of a ground truth
    #[arg(skip)]
    pub gravity_in_own_frame: Option<Vector3<f64>>,

    /// Cameras to use [default: all]
    #[arg(long, value_enum, help_heading = INPUT)]
    pub cameras: Option<Cameras>,
    /// Begin so many seconds after the first image
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0, help_heading = INPUT)]
    pub start_at: f64,
    /// Play so many seconds of the recording [default: to its end]
    #[arg(long, value_name = "SECONDS", help_heading = INPUT)]
    pub duration: Option<f64>,
    /// Play at the speed of the recording instead of as fast as possible
    #[arg(long, help_heading = INPUT)]
    pub realtime: bool,
    /// Number of points to track in images, where the recording has no tracks.csv
    #[arg(long, value_name = "N", default_value_t = 200, help_heading = INPUT)]
    pub points: usize,

    /// How map keyframes are used [default: as the settings file says, else multi]
    #[arg(long, value_enum, help_heading = MAP)]
    pub mode: Option<Mode>,
    /// Name of this robot on the network; with --secure that of its certificate
    #[arg(long, value_name = "NAME", default_value = DEFAULT_ROBOT, help_heading = MAP)]
    pub robot: String,
    /// Format of the pose, odometry and status that are published
    #[arg(long, value_enum, default_value = "json", help_heading = MAP)]
    pub topics: TopicFormat,
    /// Maximum number of keyframes in one answer (with --mode multi or mapconst)
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u16).range(1..=64), help_heading = MAP)]
    pub max_keyframes: u16,
    /// Seconds to wait for the answer to a map query
    #[arg(long, value_name = "SECONDS", default_value_t = 2.0, help_heading = MAP)]
    pub deadline: f64,
    /// Least number of seconds between two map queries, where features are extracted from images
    #[arg(long, value_name = "SECONDS", default_value_t = 0.5, help_heading = MAP)]
    pub query_interval: f64,
    /// Number of cameras of a rig that each map query asks about at once
    ///
    /// With one, the cameras take turns. With more, the pose in the map is found sooner where one camera alone sees too little of
    /// it; each image takes as much time of the processor and of the map server as with one. A stereo pair counts as one camera.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=64), help_heading = MAP)]
    pub query_cameras: u16,

    /// Image features
    #[command(flatten)]
    pub features: FeatureArguments,
    /// Wheels
    #[command(flatten)]
    pub wheels: WheelArguments,
    /// GNSS
    #[command(flatten)]
    pub gnss: GnssArguments,

    /// How the estimator is initialized
    ///
    /// In motion, a single camera needs a change of speed or direction: at constant velocity the scale is not
    /// observable. A stereo pair can be initialized in any motion. The log and the robot's status state what is missing.
    #[arg(long, value_enum, default_value = "auto", help_heading = ESTIMATOR)]
    pub init: Init,
    /// YAML file with settings of the estimator
    ///
    /// It overrides the defaults and the noise and gravity of the IMU's sensor.yaml. Switches override it.
    #[arg(long, value_name = "FILE", help_heading = ESTIMATOR)]
    pub estimator_config: Option<PathBuf>,
    /// Number of clones in the sliding window
    #[arg(long, value_name = "N", help_heading = ESTIMATOR)]
    pub window: Option<usize>,
    /// Maximum number of landmarks in the state; 0 for a plain MSCKF
    #[arg(long, value_name = "N", help_heading = ESTIMATOR)]
    pub slam_features: Option<usize>,
    /// Calibration to estimate during the run; several are separated by commas
    #[arg(long, value_enum, value_delimiter = ',', value_name = "WHAT", help_heading = ESTIMATOR)]
    pub calibrate: Vec<Calibrate>,
    /// Time in which a rolling shutter reads an image out, from the first row to the last, seconds; one for all cameras, or one by
    /// camera separated by commas; 0 for a global shutter [default: the calibration's line_delay times the rows]
    ///
    /// The stamp of an image is that of its middle row. An unknown time is found by --calibrate readout-time, from 0 or from what is
    /// given here; the result is in summary.json.
    #[arg(long, value_name = "SECONDS[,SECONDS]", value_delimiter = ',', allow_hyphen_values = true, help_heading = ESTIMATOR)]
    pub readout_time: Vec<f64>,
    /// Do not re-linearize map updates at the PnP solution (the paper's filter without R)
    #[arg(long, help_heading = ESTIMATOR)]
    pub no_relinearize: bool,

    /// Factor on the white noise densities of the IMU's sensor.yaml [default: learned during the run]
    #[arg(long, value_name = "FACTOR", help_heading = NOISE)]
    pub imu_noise_scale: Option<f64>,
    /// Standard deviation of tracked pixels, px [default: learned during the run, from 2 px on]
    #[arg(long, value_name = "PX", help_heading = NOISE)]
    pub sigma_track: Option<f64>,
    /// Standard deviation of matched pixels in the robot's image, px [default: learned during the run, at least 1 px]
    #[arg(long, value_name = "PX", help_heading = NOISE)]
    pub sigma_match: Option<f64>,
    /// Standard deviation of matched pixels in the map's images, px [default: learned, at least what the map states]
    #[arg(long, value_name = "PX", help_heading = NOISE)]
    pub sigma_map: Option<f64>,
    /// Initial standard deviation of an unknown gyroscope bias, rad/s
    #[arg(long, value_name = "RAD/S", help_heading = NOISE)]
    pub sigma_gyroscope_bias: Option<f64>,
    /// Initial standard deviation of an unknown accelerometer bias, m/s^2
    #[arg(long, value_name = "M/S2", help_heading = NOISE)]
    pub sigma_accelerometer_bias: Option<f64>,
}

impl RobotArguments {
    /// All switches at their defaults.
    ///
    /// # Errors
    /// None in practice: the defaults are valid.
    pub fn with_defaults(out: &Path) -> Result<Self> {
        #[derive(Parser)]
        struct Defaults {
            #[command(flatten)]
            robot: RobotArguments,
        }
        let line = [OsStr::new("robot"), OsStr::new("--out"), out.as_os_str()];
        Ok(Defaults::try_parse_from(line)?.robot)
    }

    /// What a recording that the robot is run on does not say of itself: calibration files and topics, those of wheels
    /// and GNSS included.
    ///
    /// # Errors
    /// Joints, counts or an origin that cannot be.
    pub fn recording_files(&self, calibration: &CalibrationArguments) -> Result<CalibrationFiles> {
        let mut files = calibration.files();
        self.wheels.name_topic(&mut files)?;
        self.gnss.name_topic(&mut files)?;
        Ok(files)
    }

    /// Puts the robot's frame where the switch says, else where the transforms of a recording say; without either it
    /// stays.
    pub fn mount_as_in(&mut self, recording: &Recording<'_>) {
        let given = self.imu_in_base_link.map(ImuInBaseLink::imu_from_base);
        let stated = given.or_else(|| recording.imu_from_base(&self.body.frames.base_link));
        if let Some(imu_from_base) = stated {
            self.body.mount = BaseMount::known(imu_from_base);
        }
    }

    /// How many bytes the output folder may have; `None` without a limit.
    pub(crate) fn out_limit(&self, is_live: bool) -> Option<u64> {
        let megabytes = self.out_limit_mb.or(is_live.then_some(LIVE_OUT_LIMIT_MB));
        megabytes.map(|megabytes| u64::from(megabytes) * 1_000_000)
    }

    /// How map keyframes are used: by the switch, else by the settings file, else the default.
    ///
    /// # Errors
    /// [`SettingsError`]: the settings file cannot be used.
    pub fn map_mode(&self) -> Result<MapMode, SettingsError> {
        match (self.mode, &self.estimator_config) {
            (Some(mode), _) => Ok(mode.into()),
            (None, Some(path)) => Ok(read_settings(path, &EstimatorConfig::default())?.mode),
            (None, None) => Ok(EstimatorConfig::default().mode),
        }
    }

    /// Settings of the calibration, overridden by the settings file.
    fn settled(&self, of_sensor: EstimatorConfig) -> Result<EstimatorConfig, SettingsError> {
        match &self.estimator_config {
            Some(path) => read_settings(path, &of_sensor),
            None => Ok(of_sensor),
        }
    }

    /// Whether a live robot has wheels, and GNSS, whose readings can be used.
    ///
    /// # Errors
    /// [`SettingsError`]: the settings file cannot be used.
    pub fn expected(&self, calibration: &SensorCalibration) -> Result<(bool, bool), SettingsError> {
        let settled = estimator_config(calibration).map(|of_sensor| self.settled(of_sensor)).transpose()?;
        let (wheels, gnss) = settled.map_or((None, None), |settled| (settled.wheels, settled.gnss));
        Ok((self.wheels.is_expected(wheels.as_ref()), self.gnss.is_expected(gnss.as_ref())))
    }

    /// The estimator's settings: defaults, overridden by the IMU's calibration, then by the settings file, then by the
    /// switches.
    ///
    /// # Arguments
    /// * `contents`: wheels and GNSS are used where the source has readings of them.
    ///
    /// # Errors
    /// There is no IMU, the settings file cannot be used, or a setting is out of range.
    pub fn estimator_config(
        &self,
        calibration: &SensorCalibration,
        contents: Contents,
    ) -> Result<EstimatorConfig> {
        let Some(of_sensor) = estimator_config(calibration) else {
            bail!(
                "there is no IMU, which the estimator needs: mav0/imu0 in a folder, a topic of sensor_msgs/Imu in a bag (`driftless \
                 info REC` lists its topics)"
            )
        };
        let mut config = self.settled(of_sensor)?;
        if let Some(scale) = self.imu_noise_scale {
            if !(scale.is_finite() && scale > 0.0) {
                bail!("--imu-noise-scale is {scale}; it must be a positive number");
            }
            config.imu_noise = config.imu_noise.inflated(scale);
        }
        config.adaptive_noise.imu &= self.imu_noise_scale.is_none();
        config.adaptive_noise.tracks &= self.sigma_track.is_none();
        config.adaptive_noise.matches &= self.sigma_match.is_none() && self.sigma_map.is_none();
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
        config.calibration.readout_time |= self.calibrate.contains(&Calibrate::ReadoutTime);
        if !self.readout_time.is_empty() {
            config.readout_times_s.clone_from(&self.readout_time);
        }
        config.wheels = self.wheels.wheels(config.wheels, contents)?;
        config.gnss = self.gnss.gnss(config.gnss, contents)?;
        config.validate().map_err(|reason| anyhow::anyhow!("settings of the estimator: {reason}"))?;
        let held = config.max_held_keyframes;
        if held > protocol::MAX_HELD_KEYFRAMES {
            let most = protocol::MAX_HELD_KEYFRAMES;
            bail!("settings of the estimator: max_held_keyframes is {held}; a query may name {most}");
        }
        Ok(config)
    }

    /// Number of cameras to use.
    ///
    /// # Errors
    /// There is no camera, or --cameras stereo and only one.
    pub fn camera_count(&self, calibration: &SensorCalibration) -> Result<usize> {
        let available = calibration.cameras.len();
        if available == 0 {
            bail!("there is no camera, which the estimator needs");
        }
        match self.cameras {
            Some(Cameras::Mono) => Ok(1),
            None | Some(Cameras::All) => Ok(available),
            Some(Cameras::Stereo) if available >= 2 => Ok(2),
            Some(Cameras::Stereo) => {
                bail!("--cameras stereo: there is only one camera; add mav0/cam1, or use --cameras mono")
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use estimator::ImuNoise;
    use sensors::{ImuSensor, Sequence};

    /// Sensors whose calibration states the local gravity.
    fn calibration() -> SensorCalibration {
        let imu = ImuSensor {
            noise: ImuNoise::default(),
            rate_hz: 200.0,
            gravity_magnitude: Some(9.79),
            intrinsics: None,
        };
        SensorCalibration { imu: Some(imu), cameras: Vec::new(), wheels: None, gnss: None }
    }

    #[test]
    fn a_switch_overrides_the_file_and_the_file_overrides_the_sensor() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("settings.yaml");
        let calibration = calibration();
        let settled = |file: Option<&str>, mode: Option<Mode>| {
            let mut arguments = RobotArguments::with_defaults(folder.path()).unwrap();
            arguments.mode = mode;
            if let Some(text) = file {
                std::fs::write(&path, text).unwrap();
                arguments.estimator_config = Some(path.clone());
            }
            let config = arguments.estimator_config(&calibration, Contents::default()).unwrap();
            assert_eq!(config.mode, arguments.map_mode().unwrap());
            (config.gravity, config.mode)
        };
        assert_eq!(settled(None, None), (9.79, MapMode::Multi));
        assert_eq!(settled(Some("window: 9"), None), (9.79, MapMode::Multi));
        assert_eq!(settled(Some("gravity: 9.83\nmode: single"), None), (9.83, MapMode::Single));
        assert_eq!(settled(Some("mode: single"), Some(Mode::Mapconst)), (9.79, MapMode::MapConst));
    }

    #[test]
    fn the_files_of_a_recording_have_the_topics_of_wheels_and_gnss() {
        #[derive(Parser)]
        struct Line {
            #[command(flatten)]
            robot: RobotArguments,
            #[command(flatten)]
            calibration: CalibrationArguments,
        }
        let files = |line: &str| {
            let line = ["robot --out out", line].join(" ");
            let Line { robot, calibration } = Line::try_parse_from(line.split(' ')).unwrap();
            robot.recording_files(&calibration)
        };
        let (wheels, gnss) =
            ("--wheel-topic /w --wheel-joints l,r", "--gnss-topic /fix --gnss-origin 47,8,400");
        let named = files(&format!("--imu-topic /imu {wheels} {gnss}")).unwrap();
        assert_eq!(named.topics().collect::<Vec<_>>(), ["/imu", "/w", "/fix"]);
        assert_eq!(named.wheel_joints, ["l", "r"]);
        assert_eq!(named.gnss_origin.map(|origin| origin.longitude_deg), Some(8.0));
        assert!(files("--wheel-topic /w --wheel-joints l,r,s").is_err());
    }

    #[test]
    fn the_robot_is_mounted_as_the_switch_says_and_stays_where_nothing_does() {
        let recording = Sequence {
            root: PathBuf::new(),
            imu: None,
            imu_samples: Vec::new(),
            wheels: None,
            wheel_readings: Vec::new(),
            gnss: None,
            gnss_readings: Vec::new(),
            cameras: Vec::new(),
            frames: Vec::new(),
            groundtruth: None,
            reference_poses: None,
        };
        let mut robot = RobotArguments::with_defaults(Path::new("out")).unwrap();
        let before = robot.body.mount.imu_from_base();
        robot.mount_as_in(&Recording::from(&recording));
        assert_eq!(robot.body.mount.imu_from_base(), before);
        robot.imu_in_base_link = Some("0.5,0,0,0,0,0".parse().unwrap());
        robot.mount_as_in(&Recording::from(&recording));
        assert_eq!(robot.body.mount.imu_from_base().translation, Vector3::new(-0.5, 0.0, 0.0));
    }
}
