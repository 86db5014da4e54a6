//! From the images of a recording and the gyroscope to feature tracks.
//!
//! The gyroscope says how the camera turned since the image before; its bias is learned from how the images say that
//! it turned.

use estimator::TrackObservation;
use estimator::imu::{ImuBuffer, ImuSample};
use geometry::Rotation;
use geometry::rotation::{exp, log};
use nalgebra::Vector3;
use sensors::{CameraSensor, Frame};
use vision::tracking::{Tracker, TrackerError, TrackerFrame, TrackerOptions, TrackerReport};
use vision::{GrayImage, ImageError};

/// How long a reading of the gyroscope may be held where the recording begins or ends, nanoseconds.
const IMU_SLACK_NS: i64 = 20_000_000;
/// Least share of a new image in the estimate of the gyroscope's bias.
const BIAS_GAIN: f64 = 0.02;
/// Largest bias to believe, rad/s. Consumer sensors reach 0.1.
const MAX_BIAS: f64 = 0.3;
/// Images whose tracks agree on a rotation, after which the bias is known.
const BIAS_IMAGES: usize = 20;
/// Standard deviation of the rate of turn, rad/s, before the bias is known and after.
const RATE_SIGMA: [f64; 2] = [0.1, 0.02];
/// The rotation is never known better than this, radians: vibration, time offset.
const MIN_ROTATION_SIGMA: f64 = 5e-4;

/// Why an image brought no tracks. The next one may.
#[derive(Debug, thiserror::Error)]
pub enum FrontEndError {
    /// The image cannot be read.
    #[error("the image is left out: {0}")]
    Image(#[from] ImageError),
    /// The tracker does not take it.
    #[error("the image of {stamp_ns} ns is left out: {source}")]
    Tracker {
        /// Time of the image.
        stamp_ns: i64,
        /// Why not.
        source: TrackerError,
    },
    /// The first camera has no image at this time.
    #[error("camera 0 has no image at {stamp_ns} ns")]
    NoImage {
        /// The time.
        stamp_ns: i64,
    },
}

/// Turns the images of a rig into tracks.
#[derive(Debug)]
pub struct FrontEnd {
    tracker: Tracker,
    cameras: usize,
    imu_from_camera: Rotation,
    gyroscope_bias: Vector3<f64>,
    /// Images that the bias was learned from.
    learned: usize,
}

impl FrontEnd {
    /// A front end for one camera or a stereo pair.
    ///
    /// # Arguments
    /// * `cameras`: the rig; a third camera and further ones are left alone.
    ///
    /// # Errors
    /// A mask of the wrong size.
    ///
    /// # Panics
    /// Without any camera.
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
            learned: 0,
        })
    }

    /// Tells the gyroscope's bias (rad/s), from a start at rest or from the filter.
    pub fn set_gyroscope_bias(&mut self, bias: Vector3<f64>) {
        self.gyroscope_bias = bias;
        self.learned = self.learned.max(BIAS_IMAGES);
    }

    /// The gyroscope's bias as the images say, rad/s.
    pub fn gyroscope_bias(&self) -> Vector3<f64> {
        self.gyroscope_bias
    }

    /// Time of the last image that was tracked, nanoseconds; the readings since then are needed for the next.
    pub fn last_stamp_ns(&self) -> Option<i64> {
        self.tracker.last_stamp_ns()
    }

    /// What happened to the tracks at the last image.
    pub fn report(&self) -> &TrackerReport {
        self.tracker.report()
    }

    /// Reads the images of a frame and follows the points in them.
    ///
    /// # Arguments
    /// * `imu`: readings in order of time, those since the last image among them; without them the rotation is taken
    ///   from the images alone.
    ///
    /// # Returns
    /// The points in sight, camera 0 first.
    ///
    /// # Errors
    /// [`FrontEndError`] where camera 0 has no image that can be used. Tracks go on at the next one. A damaged image
    /// of camera 1 is only warned about.
    pub fn look(&mut self, frame: &Frame, imu: &[ImuSample]) -> Result<Vec<TrackObservation>, FrontEndError> {
        let stamp_ns = frame.stamp_ns;
        let path = frame.images[0].as_ref().ok_or(FrontEndError::NoImage { stamp_ns })?;
        let image = GrayImage::read(path)?;
        let second_path = frame.images[1].as_ref().filter(|_| self.cameras > 1);
        let second_image = second_path.and_then(|path| match GrayImage::read(path) {
            Ok(image) => Some(image),
            Err(error) => {
                tracing::warn!("the second image is left out: {error}");
                None
            }
        });
        self.track(stamp_ns, image, second_image, imu)
    }

    /// [`FrontEnd::look`] for images that are in memory already.
    ///
    /// # Errors
    /// [`FrontEndError::Tracker`].
    pub fn track(
        &mut self,
        stamp_ns: i64,
        image: GrayImage,
        second_image: Option<GrayImage>,
        imu: &[ImuSample],
    ) -> Result<Vec<TrackObservation>, FrontEndError> {
        let last_ns = self.tracker.last_stamp_ns();
        let seconds = last_ns.map_or(0.0, |last_ns| (stamp_ns - last_ns) as f64 * 1e-9);
        let rotation = last_ns.and_then(|last_ns| self.turned(imu, last_ns, stamp_ns));
        let rate_sigma = RATE_SIGMA[usize::from(self.learned >= BIAS_IMAGES)];
        let rotation_sigma = (rate_sigma * seconds).max(MIN_ROTATION_SIGMA);
        let input =
            TrackerFrame { stamp_ns, image, second_image, rotation, sigma_rotation_rad: rotation_sigma };
        let pixels =
            self.tracker.track(input).map_err(|source| FrontEndError::Tracker { stamp_ns, source })?;
        if let Some(rotation) = rotation {
            self.learn_bias(&rotation, seconds);
        }
        let observation = |pixel: &vision::tracking::TrackedPixel| TrackObservation {
            camera: pixel.camera,
            feature_id: pixel.feature_id,
            pixel: pixel.pixel,
        };
        Ok(pixels.iter().map(observation).collect())
    }

    /// How the camera turned between two instants, `current_from_previous`; none where readings are missing.
    fn turned(&self, imu: &[ImuSample], from_ns: i64, to_ns: i64) -> Option<Rotation> {
        let begin = imu.partition_point(|sample| sample.stamp_ns <= from_ns).saturating_sub(1);
        let end = (imu.partition_point(|sample| sample.stamp_ns < to_ns) + 1).min(imu.len());
        let mut buffer = ImuBuffer::default();
        for sample in imu.get(begin..end)? {
            buffer.push(*sample).ok()?;
        }
        let readings = buffer.interval(from_ns, to_ns, IMU_SLACK_NS).ok()?;
        let previous_from_current = readings.windows(2).fold(Rotation::identity(), |turned, pair| {
            let rate = 0.5 * (pair[0].gyroscope + pair[1].gyroscope) - self.gyroscope_bias;
            turned * exp(&(rate * ((pair[1].stamp_ns - pair[0].stamp_ns) as f64 * 1e-9)))
        });
        Some(self.imu_from_camera.inverse() * previous_from_current.inverse() * self.imu_from_camera)
    }

    /// Averages by how much faster the gyroscope turned than the images.
    fn learn_bias(&mut self, predicted: &Rotation, seconds: f64) {
        let Some(motion) = &self.tracker.report().motion else { return };
        let off = log(&(motion.current_from_previous * predicted.inverse()));
        self.learned += 1;
        let gain = (1.0 / self.learned as f64).max(BIAS_GAIN);
        self.gyroscope_bias += self.imu_from_camera * off * (gain / seconds);
        self.gyroscope_bias = self.gyroscope_bias.map(|value| value.clamp(-MAX_BIAS, MAX_BIAS));
    }
}
