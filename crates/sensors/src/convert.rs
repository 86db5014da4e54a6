//! A recording in another format.

use crate::ros::{image_message, imu_message};
use crate::ros_bag::{RosBagWriter, message_type};
use crate::{
    CalibrationFiles, Frame, Recording, SensorError, SensorEvent, SensorSource, Sequence, SequenceError,
    writer,
};
use bags::{BagError, Format};
use ros_messages::sensor_msgs::Imu;
use ros_messages::{CdrError, encode};
use std::path::{Path, PathBuf};
use vision::ImageError;

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
    /// The folder with the calibration, in the EuRoC layout; for `--calibration` where it is not that of the recording.
    pub calibration: PathBuf,
    /// What the format has no place for.
    pub left_out: Vec<&'static str>,
}

/// Writes a recording in another format, with its calibration. Readings, stamps and pixels are the same; a calibrated
/// offset of the cameras' clock is part of the stamps then.
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
        for (camera, image) in frame.images.iter().enumerate() {
            let Some(image) = image else { continue };
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
    Ok(Converted { frames: sequence.frames.len(), calibration: out.to_path_buf(), left_out: Vec::new() })
}

fn to_bag(
    input: &Path,
    files: &CalibrationFiles,
    out: &Path,
    target: Target,
    mut progress: impl FnMut(usize),
) -> Result<Converted, ConvertError> {
    let recording = Recording::open_with(input, files)?;
    // That of a folder is found within it.
    let (format, calibration) = if target == Target::Rosbag2 {
        (Format::Rosbag2, out.to_path_buf())
    } else {
        let stem = out.file_stem().unwrap_or_default().to_string_lossy();
        (Format::Mcap, out.with_file_name(format!("{stem}_calibration")))
    };
    if target == Target::Mcap && calibration.exists() {
        return Err(ConvertError::Exists { path: calibration });
    }
    let mut bag = RosBagWriter::create(out, format)?;
    let mut source = recording.source()?;
    let mut frames = 0;
    while let Some(event) = source.next()? {
        match event {
            SensorEvent::Imu(reading) => {
                let stamp_ns = reading.stamp_ns;
                let message = imu_message(&reading, "imu").ok_or(ConvertError::Time { stamp_ns })?;
                bag.write("/imu0", message_type::<Imu>, stamp_ns, &encode(&message)?)?;
            }
            SensorEvent::Frame(frame) => {
                write_images(&mut bag, &frame)?;
                frames += 1;
                progress(frames);
            }
            SensorEvent::Tick => {}
        }
    }
    bag.finish()?;
    writer::write_calibration(recording.calibration(), &calibration)?;
    let contents = recording.contents();
    let parts = [
        (contents.tracks, "tracks"),
        (contents.features, "features"),
        (recording.has_truth(), "the ground truth"),
    ];
    let left_out = parts.into_iter().filter(|(is_there, _)| *is_there).map(|(_, name)| name).collect();
    Ok(Converted { frames, calibration, left_out })
}

fn write_images(bag: &mut RosBagWriter, frame: &Frame) -> Result<(), ConvertError> {
    let stamp_ns = frame.stamp_ns;
    for (camera, image) in frame.images.iter().enumerate() {
        let Some(image) = image else { continue };
        let message = image_message(image, stamp_ns, &format!("cam{camera}"))?
            .ok_or(ConvertError::Time { stamp_ns })?;
        bag.write(&message.topic(camera), || message.message_type(), stamp_ns, &message.encode()?)?;
    }
    Ok(())
}
