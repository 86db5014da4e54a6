//! A recording in another format.

use crate::ros::{
    GNSS_TOPIC, RosSensors, WHEEL_TOPIC, image_message, imu_message, position_message, wheel_message,
};
use crate::ros_bag::{RosBagWriter, message_type};
use crate::{
    CalibrationFiles, Frame, Recording, SensorCalibration, SensorError, SensorEvent, SensorSource, Sequence,
    SequenceError, writer,
};
use bags::{BagError, Format};
use ros_messages::builtin_interfaces::Time;
use ros_messages::geometry_msgs::PoseWithCovarianceStamped;
use ros_messages::sensor_msgs::{CameraInfo, Imu, JointState};
use ros_messages::tf2_msgs::TFMessage;
use ros_messages::{CdrError, encode};
use std::path::{Path, PathBuf};
use vision::ImageError;

/// Frames in which readings of wheels and positions of GNSS are written.
const BASE: &str = "base_link";
const MAP: &str = "map";

/// What a recording becomes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Target {
    /// A folder in the EuRoC layout.
    Euroc,
    /// An MCAP file with messages of ROS 2.
    Mcap,
    /// A rosbag2: a folder with SQLite in it.
    Rosbag2,
}

/// Why a recording was not converted. What was written up to there remains.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConvertError {
    /// There is something already.
    #[error("{} exists already: name another, or remove it", path.display())]
    Exists {
        /// The file or folder.
        path: PathBuf,
    },
    /// The recording cannot be read, or the folder not written.
    #[error(transparent)]
    Sequence(#[from] SequenceError),
    /// The recording cannot be read any further.
    #[error(transparent)]
    Source(#[from] SensorError),
    /// An image cannot be read or written.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// The bag cannot be written.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// A message cannot be written.
    #[error(transparent)]
    Cdr(#[from] CdrError),
    /// A stamp is not one of ROS.
    #[error("the time {stamp_ns} ns cannot be written in ROS: from 1901 to 2038 only")]
    Time {
        /// Nanoseconds since 1970.
        stamp_ns: i64,
    },
    /// A file cannot be copied.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
}

/// What was written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Converted {
    /// Frames.
    pub frames: usize,
    /// What the format has no place for.
    pub left_out: Vec<&'static str>,
}

/// Writes a recording in another format, with its calibration, so that nothing else is needed to read it. Readings, stamps and pixels
/// are the same; a calibrated offset of the cameras' clock is part of the stamps then.
///
/// # Arguments
/// * `files`: as for [`Recording::open_with`].
/// * `out`: a file or folder that does not exist.
/// * `progress`: called with the number of frames that are written.
///
/// # Errors
/// [`ConvertError`].
pub fn convert(
    input: &Path,
    files: &CalibrationFiles,
    out: &Path,
    target: Target,
    progress: impl FnMut(usize),
) -> Result<Converted, ConvertError> {
    if out.exists() {
        return Err(ConvertError::Exists { path: out.to_path_buf() });
    }
    match target {
        Target::Euroc => to_folder(input, files, out, progress),
        Target::Mcap | Target::Rosbag2 => to_bag(input, files, out, target, progress),
    }
}

fn to_folder(
    input: &Path,
    files: &CalibrationFiles,
    out: &Path,
    mut progress: impl FnMut(usize),
) -> Result<Converted, ConvertError> {
    let sequence = Sequence::open_with(input, files)?;
    writer::write(&sequence, out)?;
    for (index, frame) in sequence.frames.iter().enumerate() {
        for (camera, image) in &frame.images {
            let folder = out.join(format!("mav0/cam{camera}/data"));
            let io = |source| ConvertError::Io { path: folder.clone(), source };
            std::fs::create_dir_all(&folder).map_err(io)?;
            let to = folder.join(writer::image_name(frame.stamp_ns, Some(image)));
            match image.path() {
                Some(from) => drop(std::fs::copy(from, &to).map_err(io)?),
                None => image.read()?.write(&to)?,
            }
        }
        progress(index + 1);
    }
    Ok(Converted { frames: sequence.frames.len(), left_out: Vec::new() })
}

fn to_bag(
    input: &Path,
    files: &CalibrationFiles,
    out: &Path,
    target: Target,
    mut progress: impl FnMut(usize),
) -> Result<Converted, ConvertError> {
    let recording = Recording::open_with(input, files)?;
    let calibration = recording.calibration();
    let sensors = RosSensors::new(&[], &calibration.cameras);
    sensors.warn_of_unnamed_models();
    let format = if target == Target::Rosbag2 { Format::Rosbag2 } else { Format::Mcap };
    let mut bag = RosBagWriter::create(out, format)?;
    let SensorCalibration { wheels, gnss, .. } = calibration;
    bag.write_sensors(&sensors, calibration)?;
    let mut source = recording.source()?;
    let mut frames = 0;
    let mut is_mounted = false;
    while let Some(event) = source.next()? {
        if let Some(stamp_ns) = event.stamp_ns().filter(|_| !is_mounted) {
            is_mounted = true;
            write_mounting(&mut bag, &sensors, stamp_ns)?;
        }
        match event {
            SensorEvent::Imu(reading) => {
                let stamp_ns = reading.stamp_ns;
                let message =
                    imu_message(&reading, sensors.imu_frame()).ok_or(ConvertError::Time { stamp_ns })?;
                bag.write("/imu0", message_type::<Imu>, stamp_ns, &encode(&message)?)?;
            }
            SensorEvent::Frame(frame) => {
                write_images(&mut bag, &sensors, &frame)?;
                frames += 1;
                progress(frames);
            }
            SensorEvent::Wheels(reading) => {
                let Some(kind) = wheels.map(|wheels| wheels.base.kind()) else { continue };
                let stamp_ns = reading.stamp_ns;
                let message = wheel_message(&reading, kind, BASE).ok_or(ConvertError::Time { stamp_ns })?;
                bag.write(WHEEL_TOPIC, message_type::<JointState>, stamp_ns, &encode(&message)?)?;
            }
            SensorEvent::Gnss(reading) if gnss.is_some() => {
                let stamp_ns = reading.stamp_ns;
                let message = position_message(&reading, MAP).ok_or(ConvertError::Time { stamp_ns })?;
                bag.write(
                    GNSS_TOPIC,
                    message_type::<PoseWithCovarianceStamped>,
                    stamp_ns,
                    &encode(&message)?,
                )?;
            }
            SensorEvent::Gnss(_) | SensorEvent::Tick => {}
        }
    }
    bag.finish()?;
    let contents = recording.contents();
    let parts = [
        (contents.tracks, "tracks"),
        (contents.features, "features"),
        (contents.wheels.is_some() && wheels.is_none(), "the wheels"),
        (contents.gnss && gnss.is_none(), "GNSS"),
        (recording.has_truth(), "the ground truth"),
    ];
    let left_out = parts.into_iter().filter(|(is_there, _)| *is_there).map(|(_, name)| name).collect();
    Ok(Converted { frames, left_out })
}

fn write_mounting(bag: &mut RosBagWriter, sensors: &RosSensors, stamp_ns: i64) -> Result<(), ConvertError> {
    let stamp = Time::from_nanoseconds(stamp_ns).ok_or(ConvertError::Time { stamp_ns })?;
    let mounting = TFMessage { transforms: sensors.mounting(stamp) };
    Ok(bag.write("/tf_static", message_type::<TFMessage>, stamp_ns, &encode(&mounting)?)?)
}

/// Writes the images of a frame, each after the projection of its camera.
fn write_images(bag: &mut RosBagWriter, sensors: &RosSensors, frame: &Frame) -> Result<(), ConvertError> {
    let stamp_ns = frame.stamp_ns;
    for (&camera, image) in &frame.images {
        // Recordings have images of calibrated cameras only.
        let Some(name) = sensors.camera_frame(camera) else { continue };
        let message = image_message(image, stamp_ns, name)?.ok_or(ConvertError::Time { stamp_ns })?;
        if let Some((topic, info)) = sensors.info(camera, stamp_ns) {
            bag.write(&topic, message_type::<CameraInfo>, stamp_ns, &encode(&info)?)?;
        }
        bag.write(&message.topic(camera), || message.message_type(), stamp_ns, &message.encode()?)?;
    }
    Ok(())
}
