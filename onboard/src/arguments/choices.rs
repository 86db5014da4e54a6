//! Values of switches.

use clap::ValueEnum;
use estimator::MapMode;
use protocol::Format;

/// Where measurements come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Source {
    /// A recording: --sequence.
    #[default]
    Recording,
    /// Live sensors over Zenoh, in Driftless' own messages; needs --calibration.
    Native,
    /// Topics of ROS 2 over Zenoh: --imu-topic, --camera-topic; needs --calibration.
    Ros2,
}

/// What live frames are made of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum FrameKind {
    /// Images.
    #[default]
    Images,
    /// Tracks of a front end that runs elsewhere.
    Tracks,
    /// Such tracks, with features for place recognition.
    Features,
}

/// Cameras to use.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Cameras {
    /// Only cam0.
    Mono,
    /// cam0 and cam1.
    Stereo,
    /// Every camera.
    All,
}

/// What to do with the map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Mode {
    /// No map: visual-inertial odometry only.
    Odometry,
    /// Only the best keyframe of each answer (SM in the paper).
    Single,
    /// Several keyframes of each answer (MM in the paper).
    Multi,
    /// Takes the map as exact: overconfident, for comparison only.
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

/// Format of the messages that a robot publishes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum TopicFormat {
    /// For everybody: a pose with covariances is 1.9 kB.
    Json,
    /// For Driftless programs and narrow links: 0.7 kB.
    Bincode,
}

impl From<TopicFormat> for Format {
    fn from(format: TopicFormat) -> Self {
        match format {
            TopicFormat::Json => Self::Json,
            TopicFormat::Bincode => Self::Bincode,
        }
    }
}

/// How the estimator is initialized.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Init {
    /// After half a second at rest or a second or two in motion, whichever comes first; no pose until then.
    Auto,
    /// From the first half second, which must be at rest.
    Static,
    /// From the first row of the ground truth: to compare filters without errors of the initialization.
    Truth,
}

/// What can be estimated while running.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Calibrate {
    /// Pose of each camera in the IMU frame.
    Extrinsics,
    /// Focal length, centre and distortion of each camera.
    Intrinsics,
    /// Offset between the clocks of cameras and IMU.
    TimeOffset,
    /// Readout time of each camera's rolling shutter.
    ReadoutTime,
}
