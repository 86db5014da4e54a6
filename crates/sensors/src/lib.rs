//! Recorded runs on disk: the EuRoC ASL layout, and what stands in for images where there are none.
//!
//! ```text
//! SEQ/mav0/imu0/{sensor.yaml,data.csv}                   the IMU, if there was one
//! SEQ/mav0/cam0/{sensor.yaml,data.csv}                   a camera and the stamps of its images; cam1 alike
//! SEQ/mav0/cam0/data/*                                   the images themselves, PNG or JPEG, where there are any
//! SEQ/mav0/cam0/tracks.csv                               what an odometry front end tracked
//! SEQ/mav0/cam0/features.csv                             what a place-recognition extractor saw
//! SEQ/mav0/state_groundtruth_estimate0/data.csv          the truth, if known
//! SEQ/reference_poses.csv                                poses to build a map from
//! ```
//! The body frame is the IMU's. A [`Sequence`] is read into memory and checked at once: one that exists is in order of
//! time, finite, and calibrated. A [`Recording`] is checked the same way, but read again while it is played.
//!
//! ```no_run
//! let sequence = sensors::Sequence::open("recording".as_ref())?;
//! println!("{} frames, {} IMU samples", sequence.frames.len(), sequence.imu_samples.len());
//! # Ok::<(), sensors::SequenceError>(())
//! ```
#![cfg_attr(test, allow(clippy::unwrap_used))]

mod error;
mod features;
mod frames;
mod gravity;
mod recording;
mod rows;
mod sensor;
mod table;
mod truth;
pub mod writer;

#[cfg(test)]
mod tests;

pub use error::SequenceError;
pub use estimator::{ImuNoise, ImuSample, TrackObservation};
pub use features::{feature_set, kind_of, metric_of};
pub use frames::Frame;
pub use recording::{Contents, Recording, Rows};
pub use rows::{ReferencePose, TruthRow, read_groundtruth, read_reference_poses};
pub use sensor::{CameraSensor, ImuSensor, read_lens};
pub use truth::TruthTrack;

pub use rows::pose as pose_cells;
pub use table::{Row, Table, check_order};

use nalgebra::Vector3;
use std::path::{Path, PathBuf};

/// A recorded run.
#[derive(Clone, Debug, PartialEq)]
pub struct Sequence {
    /// Where it lies.
    pub root: PathBuf,
    /// The IMU; recordings that only serve to build maps may have none.
    pub imu: Option<ImuSensor>,
    /// Its samples, strictly increasing in time and finite; empty without an IMU.
    pub imu_samples: Vec<ImuSample>,
    /// One camera, or two of a stereo pair.
    pub cameras: Vec<CameraSensor>,
    /// All instants at which a camera looked, strictly increasing in time.
    pub frames: Vec<Frame>,
    /// Ground truth, if there is any.
    pub groundtruth: Option<Vec<TruthRow>>,
    /// Poses to build a map from, if there are any.
    pub reference_poses: Option<Vec<ReferencePose>>,
}

impl Sequence {
    /// Reads a recording.
    ///
    /// # Errors
    /// [`SequenceError`] with the file, the line, and what to do: a missing calibration or table, a row that is cut
    /// off or not finite, time stamps out of order, tracks or features of an image that is not listed, a lens or a
    /// descriptor that cannot be understood.
    pub fn open(root: &Path) -> Result<Self, SequenceError> {
        let recording = Recording::open_unchecked(root)?;
        let imu_samples = recording.imu_samples()?.collect::<Result<_, _>>()?;
        let frames = recording.frames()?.collect::<Result<_, _>>()?;
        let groundtruth: Vec<TruthRow> = recording.truth()?.collect::<Result<_, _>>()?;
        let reference_path = root.join("reference_poses.csv");
        let reference_poses =
            reference_path.exists().then(|| read_reference_poses(&reference_path)).transpose()?;
        Ok(Self {
            root: recording.root,
            imu: recording.imu,
            imu_samples,
            cameras: recording.cameras,
            frames,
            groundtruth: (!groundtruth.is_empty()).then_some(groundtruth),
            reference_poses,
        })
    }

    /// Whether camera 0 has an image of any frame.
    pub fn has_images(&self) -> bool {
        self.frames.iter().any(|frame| frame.images[0].is_some())
    }

    /// Whether any frame has features for place recognition.
    pub fn has_features(&self) -> bool {
        self.frames.iter().any(|frame| frame.features.is_some())
    }

    /// Unit direction in which gravity pulls, in the frame of the ground truth.
    ///
    /// Estimated from truth and IMU over the run, and taken for a coordinate axis within 3 degrees of one. `None`
    /// where truth or IMU is missing, or where they contradict each other.
    pub fn truth_gravity(&self) -> Option<Vector3<f64>> {
        // Rows in memory are sound.
        Recording::from(self).truth_gravity().ok().flatten()
    }
}
