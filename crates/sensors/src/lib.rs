//! Sensor sources: IMU readings, images, tracks and features in order of time, with the calibration of the sensors.
//!
//! | module | what |
//! |---|---|
//! | `source` | [`SensorSource`], the interface that a robot plays: [`SensorEvent`]s in order of time |
//! | `calibration`, `frame` | [`SensorCalibration`]; [`Frame`] and [`ImageData`] |
//! | `original` | [`OriginalImage`], an image as its sensor gave it |
//! | `recording`, `merged` | [`Recording`], on disk or in memory; [`RecordingSource`], which plays it |
//! | `stored` | what a format on disk provides; opening any of them |
//! | `stamps`, `pairing` | wrong stamps of a recorded stream, and its order; [`PairCounts`], which images make a stereo pair |
//! | `split_imu` | [`SplitImu`], gyroscope and accelerometer that come for themselves |
//! | `session_file` | session files of robots as recordings |
//! | `memory` | [`Sequence`], a recording in memory |
//! | [`live`] | measurements that arrive now |
//! | `euroc` | the EuRoC ASL folder layout: reader and [`writer`] |
//! | [`four_seasons`] | the folder layout of the 4Seasons dataset |
//! | `bag` (feature `bags`) | MCAP, rosbag2 and rosbag1: [`BagSensors`] |
//! | `ros` (feature `ros`); `ros_bag` (feature `bags`) | readings, images and projections as messages of ROS; bags of such messages, written |
//! | `kalibr`, `rig_calibration` | calibrations of Kalibr: [`CalibrationFiles`]; of a robot: [`read_rig_calibration`] |
//! | `imu_units` | [`ImuUnits`] of readings that are not in rad/s and m/s^2 |
//! | `gnss_intake` | positions of GNSS as they are taken in: in the frame of the map, with a covariance |
//! | `imu_intake` | units, scale and misalignment of readings as they are taken in |
//! | `imu_check`, `image_check`, `stereo_check` | units, sizes and wiring that contradict the calibration, recognized from the data |
//! | `truth`, `gravity` | ground truth, its interpolation, and the direction of gravity in its frame (evaluation only) |
//! | `table` | [`Table`], a CSV reader whose errors name file and line |
//! | `pose_columns` | [`PoseColumns`], where a table's header says that the numbers of a pose stand |
//! | `written_lines` | [`read_written_lines`], the complete lines of a file whose writer was killed |
//! | `error` | [`SensorError`] of a source, [`SequenceError`] of a file |
//!
//! A recording on disk is a folder in the EuRoC ASL layout; `tracks.csv`, `features.csv` and `reference_poses.csv` are
//! additions to it:
//! ```text
//! DIR/mav0/imu0/{sensor.yaml,data.csv}                   the IMU, if there is one
//! DIR/mav0/cam0/{sensor.yaml,data.csv}                   a camera and the time stamps of its images; cam1 alike
//! DIR/mav0/cam0/data/*                                   the images, PNG or JPEG, if there are any
//! DIR/mav0/cam0/tracks.csv                               tracked points: time, feature id, pixel; cam1 alike
//! DIR/mav0/cam0/features.csv                             features for place recognition: time, pixel, descriptor; cam1 alike
//! DIR/mav0/wheels0/{data.csv,sensor.yaml}                the wheels of a differential drive, if there are any; the geometry may be missing
//! DIR/mav0/state_groundtruth_estimate0/data.csv          ground truth, if known; or mav0/mocap0/data.csv (TUM-VI)
//! DIR/reference_poses.csv                                poses to build a map from, if there are any
//! ```
//! The body frame is the IMU's. In place of the `sensor.yaml` files, Kalibr's camera chain and `imu.yaml` may lie in `DIR`,
//! `DIR/mav0` or `DIR/dso`.
//!
//! ```no_run
//! let sequence = sensors::Sequence::open("recording".as_ref())?;
//! println!("{} frames, {} IMU samples", sequence.frames.len(), sequence.imu_samples.len());
//! # Ok::<(), sensors::SequenceError>(())
//! ```
#![cfg_attr(test, allow(clippy::unwrap_used))]

#[cfg(feature = "bags")]
mod bag;
mod calibration_files;
#[cfg(feature = "ros")]
mod camera_info;
mod clock_check;
#[cfg(feature = "bags")]
pub mod convert;
mod error;
mod euroc;
pub mod four_seasons;
mod frame;
mod gnss_intake;
mod gravity;
mod image_check;
mod imu_check;
mod imu_intake;
mod imu_units;
pub mod live;
mod memory;
mod merged;
mod original;
mod pairing;
mod pose_columns;
mod recording;
mod rig_calibration;
#[cfg(feature = "ros")]
pub mod ros;
#[cfg(feature = "bags")]
pub mod ros_bag;
#[cfg(feature = "ros")]
mod ros_gnss;
#[cfg(feature = "ros")]
mod ros_sensors;
#[cfg(feature = "ros")]
mod ros_wheels;
mod row_order;
mod rows;
mod session_file;
mod source;
mod split_imu;
mod stamps;
#[cfg(feature = "ros")]
mod static_transforms;
mod stereo_check;
mod stored;
mod table;
mod truth;
mod wheel_intake;
mod written_lines;

#[cfg(test)]
mod tests;

#[cfg(feature = "bags")]
pub use bag::{BagCamera, BagError, BagSensors};
pub use calibration::{
    CameraSensor, GnssSensor, ImuIntrinsics, ImuSensor, SensorCalibration, WheelSensor, camera_groups,
};
pub use calibration_files::CalibrationFiles;
pub use error::{SensorError, SequenceError};
pub use euroc::{
    FolderCalibration, QuaternionLength, pose_cells, pose_of, read_groundtruth, read_reference_poses,
    read_reference_positions, writer,
};
pub use frame::{Frame, ImageData, StoredImage};
pub use geometry::CameraGroup;
pub use gnss_intake::{GnssIntake, GnssProblem};
pub use gravity::direction_of_gravity;
pub use imu_check::{ImuCheck, ImuUnitError};
pub use imu_units::ImuUnits;
pub use memory::Sequence;
pub use merged::RecordingSource;
pub use original::{DecodedImage, OriginalImage, RawPixels};
pub use pairing::{PAIR_TOLERANCE_NS, PairCounts};
pub use pose_columns::{PoseColumns, QuaternionOrder};
pub use recording::Recording;
pub use rig_calibration::{read_rig_calibration, states_intrinsics};
pub use rows::Rows;
pub use source::{Contents, SensorEvent, SensorSource, WheelReadings};
pub use split_imu::SplitImu;
pub use stereo_check::check_stereo;
pub use stored::is_recording;
pub use table::{Row, Table, check_order};
pub use truth::{ReferencePose, ReferencePosition, TruthRow, TruthTrack};
pub use types::{
    BaseKind, Encoder, EncoderCounts, EncoderError, GnssReading, ImuNoise, ImuSample, MAX_WHEELS,
    TrackObservation, WheelBase, WheelReading, push_newest,
};
pub use wheel_intake::{WheelIntake, WheelProblem};
pub use written_lines::{WrittenLines, read_written_lines, warn_cut_off};
