//! The odometry's front end: from images and gyroscope readings to feature tracks.
//!
//! The gyroscope predicts the rotation of the camera since the last image. Its bias is estimated from the difference
//! to the rotation that the tracks show.

use crate::repeated_warning::RepeatedWarning;
use estimator::ImuSample;
use estimator::TrackObservation;
use estimator::imu::ImuBuffer;
use geometry::Rotation;
use geometry::rotation::{exp, log};
use nalgebra::Vector3;
use sensors::{CameraSensor, Frame};
use vision::tracking::{Tracker, TrackerError, TrackerFrame, TrackerOptions, TrackerReport};
use vision::{GrayImage, ImageError};

/// How long a reading of the gyroscope is extrapolated at the beginning and the end of the data, nanoseconds.
const IMU_SLACK_NS: i64 = 20_000_000;
/// Least weight of a new image in the average of the gyroscope's bias.
const BIAS_GAIN: f64 = 0.02;
/// Largest plausible bias, rad/s. Consumer sensors reach 0.1.
const MAX_BIAS: f64 = 0.3;
/// Number of images with a rotation estimate after which the bias is taken as known.
const BIAS_IMAGES: usize = 20;
/// Standard deviation of the angular rate, rad/s, before the bias is known and after.
const RATE_SIGMA: [f64; 2] = [0.1, 0.02];
/// Least standard deviation of the predicted rotation, radians: vibration, time offset.
const MIN_ROTATION_SIGMA: f64 = 5e-4;

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
    /// The first camera has no image at this time.
    #[error("camera 0 has no image at {stamp_ns} ns")]
    NoImage {
        /// The time.
        stamp_ns: i64,
    },
}

/// Tracks points through the images of one camera or a stereo pair.
#[derive(Debug)]
pub struct FrontEnd {
    tracker: Tracker,
    cameras: usize,
    imu_from_camera: Rotation,
    gyroscope_bias: Vector3<f64>,
    /// Number of images that the bias was estimated from.
    bias_images: usize,
    second_skipped: RepeatedWarning,
}

impl FrontEnd {
    /// A front end for one camera or a stereo pair.
    ///
    /// # Arguments
    /// * `cameras`: one or two; further ones are ignored.
    /// * `options`: of the tracker.
    ///
    /// # Errors
    /// [`TrackerError`]: a mask does not have the size of its camera's images.
    ///
    /// # Panics
    /// Panics without a camera.
    pub fn new(cameras: &[CameraSensor], options: TrackerOptions) -> Result<Self, TrackerError> {
        let first = &cameras[0];
        let second = cameras.get(1).map(|second| {
            let second_from_first = second.imu_from_camera.inverse().compose(&first.imu_from_camera);
            (second.camera.clone(), second_from_first)
        });
        Ok(Self {
            tracker: Tracker::new(first.camera.clone(), second, options)?,
            cameras: cameras.len().min(2),
            imu_from_camera: first.imu_from_camera.rotation,
            gyroscope_bias: Vector3::zeros(),
            bias_images: 0,
            second_skipped: RepeatedWarning::default(),
        })
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

    /// Time of the last tracked image, nanoseconds; the readings since then are needed for the next.
    pub fn last_stamp_ns(&self) -> Option<i64> {
        self.tracker.last_stamp_ns()
    }

    /// Counts of tracks at the last image.
    pub fn report(&self) -> &TrackerReport {
        self.tracker.report()
    }

    /// Reads the images of a frame and tracks points in them.
    ///
    /// # Arguments
    /// * `imu`: readings in order of time, those since the last image among them; without them the rotation is taken
    ///   from the images alone.
    ///
    /// # Returns
    /// The tracked points, camera 0 first.
    ///
    /// # Errors
    /// [`FrontEndError`]: camera 0 has no usable image. Tracking continues at the next frame. A damaged image of camera
    /// 1 is only logged.
    pub fn track_frame(
        &mut self,
        frame: &Frame,
        imu: &[ImuSample],
    ) -> Result<Vec<TrackObservation>, FrontEndError> {
        let stamp_ns = frame.stamp_ns;
        let first = frame.images[0].as_ref().ok_or(FrontEndError::NoImage { stamp_ns })?;
        let image = first.read()?.into_owned();
        let second = frame.images[1].as_ref().filter(|_| self.cameras > 1);
        let second_image = second.and_then(|second| match second.read() {
            Ok(image) => Some(image.into_owned()),
            Err(error) => {
                if let Some(unlogged) = self.second_skipped.note() {
                    tracing::warn!(%error, unlogged, "the image of camera 1 is skipped");
                }
                None
            }
        });
        self.track_images(stamp_ns, image, second_image, imu)
    }

    /// [`FrontEnd::track_frame`] for decoded images.
    ///
    /// # Errors
    /// [`FrontEndError::Tracker`].
    pub fn track_images(
        &mut self,
        stamp_ns: i64,
        image: GrayImage,
        second_image: Option<GrayImage>,
        imu: &[ImuSample],
    ) -> Result<Vec<TrackObservation>, FrontEndError> {
        let last_ns = self.tracker.last_stamp_ns();
        let seconds = last_ns.map_or(0.0, |last_ns| (stamp_ns - last_ns) as f64 * 1e-9);
        let rotation = last_ns.and_then(|last_ns| self.predicted_rotation(imu, last_ns, stamp_ns));
        let rate_sigma = RATE_SIGMA[usize::from(self.bias_images >= BIAS_IMAGES)];
        let rotation_sigma = (rate_sigma * seconds).max(MIN_ROTATION_SIGMA);
        let input =
            TrackerFrame { stamp_ns, image, second_image, rotation, sigma_rotation_rad: rotation_sigma };
        let pixels =
            self.tracker.track(input).map_err(|source| FrontEndError::Tracker { stamp_ns, source })?;
        if let Some(rotation) = rotation {
            self.update_bias(&rotation, seconds);
        }
        let observation = |pixel: &vision::tracking::TrackedPixel| TrackObservation {
            camera: pixel.camera,
            feature_id: pixel.feature_id,
            pixel: pixel.pixel,
        };
        Ok(pixels.iter().map(observation).collect())
    }

    /// Rotation of the camera between two instants by the gyroscope, `current_from_previous`; `None` where readings are
    /// missing.
    fn predicted_rotation(&self, imu: &[ImuSample], from_ns: i64, to_ns: i64) -> Option<Rotation> {
        let begin = imu.partition_point(|sample| sample.stamp_ns <= from_ns).saturating_sub(1);
        let end = (imu.partition_point(|sample| sample.stamp_ns < to_ns) + 1).min(imu.len());
        let mut buffer = ImuBuffer::default();
        for sample in imu.get(begin..end)? {
            buffer.push(*sample).ok()?;
        }
        let readings = buffer.interval(from_ns, to_ns, IMU_SLACK_NS).ok()?;
        let previous_from_current = readings.windows(2).fold(Rotation::identity(), |rotation, pair| {
            let rate = 0.5 * (pair[0].gyroscope + pair[1].gyroscope) - self.gyroscope_bias;
            rotation * exp(&(rate * ((pair[1].stamp_ns - pair[0].stamp_ns) as f64 * 1e-9)))
        });
        Some(self.imu_from_camera.inverse() * previous_from_current.inverse() * self.imu_from_camera)
    }

    /// Averages the difference between the gyroscope's rotation and that of the images.
    fn update_bias(&mut self, predicted: &Rotation, seconds: f64) {
        let Some(motion) = &self.tracker.report().motion else { return };
        let error = log(&(motion.current_from_previous * predicted.inverse()));
        self.bias_images += 1;
        let gain = (1.0 / self.bias_images as f64).max(BIAS_GAIN);
        self.gyroscope_bias += self.imu_from_camera * error * (gain / seconds);
        self.gyroscope_bias = self.gyroscope_bias.map(|value| value.clamp(-MAX_BIAS, MAX_BIAS));
    }
}
