//! The odometry's front end: from images and gyroscope readings to feature tracks.
//!
//! The cameras of a rig are tracked in groups ([`camera_groups`]), stereo pairs and single cameras, at the same time. A group whose
//! image is missing or damaged does not stop the others.
//!
//! The gyroscope predicts the rotation of a camera since its last image. Its bias is estimated from the difference
//! to the rotation that the tracks show.

use crate::group_tracker::{GroupTracker, GroupTracks, GyroscopeNow};
use crate::repeated_warning::RepeatedWarning;
use estimator::ImuSample;
use estimator::TrackObservation;
use nalgebra::Vector3;
use sensors::{CameraSensor, Frame, camera_groups};
use std::panic::resume_unwind;
use vision::ImageError;
use vision::tracking::{TrackerError, TrackerOptions};

/// Least weight of a new image in the average of the gyroscope's bias.
const BIAS_GAIN: f64 = 0.02;
/// Largest plausible bias, rad/s. Consumer sensors reach 0.1.
const MAX_BIAS: f64 = 0.3;
/// Number of images with a rotation estimate after which the bias is taken as known.
const BIAS_IMAGES: usize = 20;

/// Why a frame has no tracks. Tracking continues at the next one.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FrontEndError {
    /// The image cannot be read.
    #[error("the image is skipped: {0}")]
    Image(#[from] ImageError),
    /// The tracker refuses the image.
    #[error("the image at {stamp_ns} ns is skipped: {source}")]
    Tracker {
        /// Time of the image.
        stamp_ns: i64,
        /// The error of the tracker.
        source: TrackerError,
    },
    /// A camera has no image at this time.
    #[error("camera {camera} has no image at {stamp_ns} ns")]
    NoImage {
        /// The camera: the only one, or the first of a stereo pair.
        camera: usize,
        /// The time.
        stamp_ns: i64,
    },
}

/// Counts of tracks at the last frame, of all cameras.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct FrontEndReport {
    /// Tracks that were continued.
    pub continued: usize,
    /// Tracks rejected as outliers of the relative pose.
    pub outliers: usize,
}

/// Tracks points through the images of the cameras of a rig.
#[derive(Debug)]
pub struct FrontEnd {
    groups: Vec<GroupTracker>,
    max_gap_ns: i64,
    /// Added to the time of an image to obtain the IMU's, nanoseconds.
    time_offset_ns: i64,
    gyroscope_bias: Vector3<f64>,
    /// Number of images that the bias was estimated from.
    bias_images: usize,
    report: FrontEndReport,
    skipped: RepeatedWarning,
}

impl FrontEnd {
    /// A front end for a rig.
    ///
    /// # Arguments
    /// * `options`: of the tracker; points are those of a stereo pair or a single camera, masks are those of the rig's cameras.
    ///
    /// # Errors
    /// [`TrackerError`]: a mask does not have the size of its camera's images.
    ///
    /// # Panics
    /// Panics without a camera.
    pub fn new(cameras: &[CameraSensor], options: &TrackerOptions) -> Result<Self, TrackerError> {
        assert!(!cameras.is_empty(), "a front end needs a camera");
        let groups = camera_groups(cameras);
        let count = groups.len() as u64;
        let tracker = |(number, group)| GroupTracker::new(group, cameras, options, (number, count));
        Ok(Self {
            groups: (0..).zip(groups).map(tracker).collect::<Result<_, _>>()?,
            max_gap_ns: options.max_gap_ns,
            time_offset_ns: 0,
            gyroscope_bias: Vector3::zeros(),
            bias_images: 0,
            report: FrontEndReport::default(),
            skipped: RepeatedWarning::default(),
        })
    }

    /// Sets what is added to the time of an image to obtain the IMU's (ns), by the calibration or as the filter estimates it.
    pub fn set_time_offset_ns(&mut self, time_offset_ns: i64) {
        self.time_offset_ns = time_offset_ns;
    }

    /// Sets the gyroscope's bias (rad/s), from an initialization at rest or from the filter.
    pub fn set_gyroscope_bias(&mut self, bias: Vector3<f64>) {
        self.gyroscope_bias = bias;
        self.bias_images = self.bias_images.max(BIAS_IMAGES);
    }

    /// The estimated bias of the gyroscope, rad/s.
    pub fn gyroscope_bias(&self) -> Vector3<f64> {
        self.gyroscope_bias
    }

    /// Time of the oldest image from which points are still tracked, by the clock of the IMU, nanoseconds; the readings since then
    /// are needed for the next frame.
    pub fn last_stamp_ns(&self) -> Option<i64> {
        let stamps = || self.groups.iter().filter_map(GroupTracker::last_stamp_ns);
        let newest_ns = stamps().max()?;
        // The tracks of a camera that has given no image for longer have ended.
        let oldest_ns = stamps().filter(|stamp_ns| newest_ns - stamp_ns <= self.max_gap_ns).min()?;
        Some(oldest_ns + self.time_offset_ns)
    }

    /// Counts of tracks at the last frame.
    pub fn report(&self) -> &FrontEndReport {
        &self.report
    }

    /// Reads the images of a frame and tracks points in them.
    ///
    /// # Arguments
    /// * `imu`: readings in order of time, from [`Self::last_stamp_ns`] to the time of the frame by the clock of the IMU; without
    ///   them the rotation is taken from the images alone.
    ///
    /// # Returns
    /// The tracked points, in the order of the groups. A point has one identity in both images of a stereo pair.
    ///
    /// # Errors
    /// [`FrontEndError`]: no group of cameras has a usable image. Tracking continues at the next frame. Where only some groups have
    /// none, a damaged image is logged.
    pub fn track_frame(
        &mut self,
        frame: &Frame,
        imu: &[ImuSample],
    ) -> Result<Vec<TrackObservation>, FrontEndError> {
        let gyroscope = GyroscopeNow {
            readings: imu,
            time_offset_ns: self.time_offset_ns,
            bias: self.gyroscope_bias,
            bias_is_known: self.bias_images >= BIAS_IMAGES,
        };
        let mut observations = Vec::new();
        let mut report = FrontEndReport::default();
        let (mut tracked, mut failed, mut rotation_errors) = (0, Vec::new(), Vec::new());
        for (found, group) in track_groups(&mut self.groups, frame, &gyroscope) {
            match found {
                Ok(found) => {
                    tracked += 1;
                    report.continued += group.report().continued;
                    report.outliers += group.report().outliers;
                    observations.extend(found.observations);
                    rotation_errors.extend(found.rotation_error);
                }
                Err(error) => failed.push(error),
            }
        }
        for (error, seconds) in rotation_errors {
            self.update_bias(&error, seconds);
        }
        if tracked == 0 {
            // A damaged image says more than a missing one.
            let damaged = failed.iter().position(|error| !matches!(error, FrontEndError::NoImage { .. }));
            return Err(failed.swap_remove(damaged.unwrap_or(0)));
        }
        self.report = report;
        for error in failed.iter().filter(|error| !matches!(error, FrontEndError::NoImage { .. })) {
            if let Some(unlogged) = self.skipped.note() {
                tracing::warn!(%error, unlogged, "the other cameras are tracked");
            }
        }
        Ok(observations)
    }

    /// Averages the difference between the gyroscope's rotation and that of the images.
    ///
    /// # Arguments
    /// * `rotation_error`: in the IMU frame, rad.
    /// * `seconds`: the time in which it arose.
    fn update_bias(&mut self, rotation_error: &Vector3<f64>, seconds: f64) {
        self.bias_images += 1;
        let gain = (1.0 / self.bias_images as f64).max(BIAS_GAIN);
        self.gyroscope_bias += rotation_error * (gain / seconds);
        self.gyroscope_bias = self.gyroscope_bias.map(|value| value.clamp(-MAX_BIAS, MAX_BIAS));
    }
}

/// Tracks all groups at the same time, each on a thread; the last one that has an image on the caller's.
///
/// # Returns
/// What each of them found.
fn track_groups<'a>(
    groups: &'a mut [GroupTracker],
    frame: &Frame,
    gyroscope: &GyroscopeNow<'_>,
) -> Vec<(Result<GroupTracks, FrontEndError>, &'a GroupTracker)> {
    let last = groups.iter().rposition(|group| group.is_in(frame));
    let found: Vec<Result<GroupTracks, FrontEndError>> = std::thread::scope(|scope| {
        let mut running = Vec::with_capacity(groups.len());
        for (index, group) in groups.iter_mut().enumerate() {
            let needs_thread = group.is_in(frame) && Some(index) != last;
            running.push(if needs_thread {
                Err(scope.spawn(|| group.track(frame, gyroscope)))
            } else {
                Ok(group.track(frame, gyroscope))
            });
        }
        let finish = |running: Result<_, std::thread::ScopedJoinHandle<'_, _>>| {
            running.unwrap_or_else(|thread| thread.join().unwrap_or_else(|panic| resume_unwind(panic)))
        };
        running.into_iter().map(finish).collect()
    });
    found.into_iter().zip(groups.iter()).collect()
}
