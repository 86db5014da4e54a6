//! Errors of recordings and other sensor sources.

use super::ImuUnitError;
use calibration::CalibrationError;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Why a file of a recording or of a trajectory could not be read or written.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum SequenceError {
    /// A required file or folder does not exist.
    #[error("{} is missing: {advice}", path.display())]
    Missing {
        /// The file or folder.
        path: PathBuf,
        /// What to do about it.
        advice: String,
    },
    /// The operating system reports an error.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The error.
        source: std::io::Error,
    },
    /// A session file of a robot cannot be used.
    #[error(transparent)]
    Session(#[from] hand_in::HandInError),
    /// A calibration file is invalid.
    #[error("{}: {problem}", path.display())]
    Calibration {
        /// The file.
        path: PathBuf,
        /// What is wrong, and what to do.
        problem: String,
    },
    /// A line of a table is invalid.
    #[error("{}, line {line}: {problem}", path.display())]
    Row {
        /// The file.
        path: PathBuf,
        /// The line, counted from 1.
        line: u64,
        /// What is wrong, and what to do.
        problem: String,
    },
    /// An image has another size than the calibration of its camera states.
    #[error(
        "{} has {} x {} pixels, but the calibration of cam{camera} is for {} x {}: give the calibration of these images, \
         or scale resolution and intrinsics with them",
        path.display(), size.0, size.1, calibrated.0, calibrated.1
    )]
    ImageSize {
        /// The file.
        path: PathBuf,
        /// Its columns and rows.
        size: (u32, u32),
        /// Columns and rows by the calibration.
        calibrated: (u32, u32),
        /// The camera, 0 or 1.
        camera: usize,
    },
    /// The first images of a camera cannot be used, one like the other.
    #[error("the images of cam{camera} cannot be used: {source}")]
    UnusableImages {
        /// The camera, 0 or 1.
        camera: usize,
        /// Why, with the topic and the encoding.
        source: vision::ImageError,
    },
    /// The readings of the IMU are in other units, or lack gravity.
    #[error("{}: {source}", path.display())]
    ImuUnits {
        /// The file of the readings.
        path: PathBuf,
        /// What is wrong, and what to do.
        source: ImuUnitError,
    },
    /// Images and readings are stamped by two clocks, or in another unit than nanoseconds.
    #[error("{}: {problem}", path.display())]
    Clocks {
        /// The recording.
        path: PathBuf,
        /// What is wrong, and what to do.
        problem: String,
    },
    /// The images of the two cameras of a stereo pair are swapped, or their poses on the IMU.
    #[error(
        "the cameras are swapped: {as_swapped} matches of the first images lie in front of the cameras with cam{} and cam{} \
         exchanged, and {as_given} as given; exchange their images (the folders data), or the poses (T_BS) of the two cameras",
        cameras[0],
        cameras[1]
    )]
    SwappedCameras {
        /// The two cameras.
        cameras: [usize; 2],
        /// Matches that agree with the cameras as given.
        as_given: usize,
        /// Matches that agree with the cameras exchanged.
        as_swapped: usize,
    },
    /// A bag's topics are not those of a robot's sensors, or it is not clear which are meant.
    #[error("{}: {problem}", path.display())]
    Topics {
        /// The bag.
        path: PathBuf,
        /// What is wrong, and what to do.
        problem: String,
    },
    /// A bag cannot be read.
    #[cfg(feature = "bags")]
    #[error(transparent)]
    Bag(#[from] bags::BagError),
    /// A table has no rows.
    #[error("{} holds no rows: {advice}", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
        /// What to do about it.
        advice: String,
    },
}

impl SequenceError {
    /// [`SequenceError::Io`] for a file.
    pub fn io(path: &Path, source: std::io::Error) -> Self {
        Self::Io { path: path.to_path_buf(), source }
    }

    /// [`SequenceError::Calibration`] for a file.
    pub fn calibration(path: &Path, problem: impl Into<String>) -> Self {
        Self::Calibration { path: path.to_path_buf(), problem: problem.into() }
    }

    /// [`SequenceError::Missing`] for a file or folder.
    pub fn missing(path: &Path, advice: impl Into<String>) -> Self {
        Self::Missing { path: path.to_path_buf(), advice: advice.into() }
    }

    /// [`SequenceError::Empty`] for a table.
    pub fn empty(path: &Path, advice: impl Into<String>) -> Self {
        Self::Empty { path: path.to_path_buf(), advice: advice.into() }
    }
}

impl From<CalibrationError> for SequenceError {
    fn from(error: CalibrationError) -> Self {
        match error {
            CalibrationError::Missing { path, advice } => Self::Missing { path, advice },
            CalibrationError::Io { path, source } => Self::Io { path, source },
            CalibrationError::Entry { path, problem } => Self::Calibration { path, problem },
        }
    }
}

/// Why a [`SensorSource`](crate::SensorSource) ended before its end.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum SensorError {
    /// A file of a recording.
    #[error(transparent)]
    Recording(#[from] SequenceError),
    /// Any other source: a bag, a topic, a device.
    #[error("{name}: {source}")]
    Source {
        /// What was read, as [`SensorSource::name`](crate::SensorSource::name) says.
        name: String,
        /// The error of the reader.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
}
