//! The tracker of one group of cameras: a stereo pair, or a single camera.

use crate::front_end::FrontEndError;
use crate::repeated_warning::RepeatedWarning;
use estimator::imu::ImuBuffer;
use estimator::{ImuSample, TrackObservation};
use geometry::Rotation;
use geometry::rotation::{exp, log};
use nalgebra::Vector3;
use sensors::{CameraGroup, CameraSensor, Frame};
use vision::tracking::{Tracker, TrackerError, TrackerFrame, TrackerOptions, TrackerReport};

/// How long a reading of the gyroscope is extrapolated at the beginning and the end of the data, nanoseconds.
const IMU_SLACK_NS: i64 = 20_000_000;
/// Standard deviation of the angular rate, rad/s, before the bias is known and after.
const RATE_SIGMA: [f64; 2] = [0.1, 0.02];
/// Least standard deviation of the predicted rotation, radians: vibration, time offset.
const MIN_ROTATION_SIGMA: f64 = 5e-4;

/// What the gyroscope measured, and what is known of its bias.
pub(crate) struct GyroscopeNow<'a> {
    pub(crate) readings: &'a [ImuSample],
    /// Added to the time of an image to obtain the IMU's, nanoseconds.
    pub(crate) time_offset_ns: i64,
    /// rad/s.
    pub(crate) bias: Vector3<f64>,
    pub(crate) bias_is_known: bool,
}

impl GyroscopeNow<'_> {
    /// Rotation of a camera between two images, `current_from_previous`; `None` where readings are missing.
    ///
    /// # Arguments
    /// * `previous_ns`, `current_ns`: times of the images by the clock of the camera.
    fn rotation(&self, imu_from_camera: &Rotation, previous_ns: i64, current_ns: i64) -> Option<Rotation> {
        let (from_ns, to_ns) = (previous_ns + self.time_offset_ns, current_ns + self.time_offset_ns);
        let begin = self.readings.partition_point(|sample| sample.stamp_ns <= from_ns).saturating_sub(1);
        let end =
            (self.readings.partition_point(|sample| sample.stamp_ns < to_ns) + 1).min(self.readings.len());
        let mut buffer = ImuBuffer::default();
        for sample in self.readings.get(begin..end)? {
            buffer.push(*sample).ok()?;
        }
        let readings = buffer.interval(from_ns, to_ns, IMU_SLACK_NS).ok()?;
        let previous_from_current = readings.windows(2).fold(Rotation::identity(), |rotation, pair| {
            let rate = 0.5 * (pair[0].gyroscope + pair[1].gyroscope) - self.bias;
            rotation * exp(&(rate * ((pair[1].stamp_ns - pair[0].stamp_ns) as f64 * 1e-9)))
        });
        Some(imu_from_camera.inverse() * previous_from_current.inverse() * imu_from_camera)
    }
}

/// What a group sees in a frame.
pub(crate) struct GroupTracks {
    /// The tracked points, those of the first camera first.
    pub(crate) observations: Vec<TrackObservation>,
    /// Rotation of the images less that of the gyroscope, in the IMU frame (rad), and the time in which it arose (s).
    pub(crate) rotation_error: Option<(Vector3<f64>, f64)>,
}

/// Tracks points through the images of a group.
#[derive(Debug)]
pub(crate) struct GroupTracker {
    group: CameraGroup,
    tracker: Tracker,
    imu_from_camera: Rotation,
    /// Number of this group among how many: features of different groups have different identities.
    number: (u64, u64),
    second_skipped: RepeatedWarning,
}

impl GroupTracker {
    /// # Arguments
    /// * `options`: with the masks of all cameras of the rig.
    /// * `number`: of this group, and how many there are.
    pub(crate) fn new(
        group: CameraGroup,
        cameras: &[CameraSensor],
        options: &TrackerOptions,
        number: (u64, u64),
    ) -> Result<Self, TrackerError> {
        let first = &cameras[group.first];
        let second = group.second.map(|second| {
            let second = &cameras[second];
            let second_from_first = second.imu_from_camera.inverse().compose(&first.imu_from_camera);
            (second.camera.clone(), second_from_first)
        });
        let mut of_group = options.clone();
        of_group.masks = group.cameras().map(|camera| options.masks.get(camera).cloned().flatten()).collect();
        let tracker =
            Tracker::new(first.camera.clone(), second, of_group).map_err(|error| of_rig(error, group))?;
        let imu_from_camera = first.imu_from_camera.rotation;
        Ok(Self { group, tracker, imu_from_camera, number, second_skipped: RepeatedWarning::default() })
    }

    /// Whether a frame has an image of the group's first camera.
    pub(crate) fn is_in(&self, frame: &Frame) -> bool {
        frame.images.contains_key(&self.group.first)
    }

    /// Time of the last tracked image, nanoseconds.
    pub(crate) fn last_stamp_ns(&self) -> Option<i64> {
        self.tracker.last_stamp_ns()
    }

    /// Counts of tracks at the last image.
    pub(crate) fn report(&self) -> &TrackerReport {
        self.tracker.report()
    }

    /// Reads the group's images of a frame and tracks points in them. A damaged image of the second camera is only logged.
    pub(crate) fn track(
        &mut self,
        frame: &Frame,
        gyroscope: &GyroscopeNow<'_>,
    ) -> Result<GroupTracks, FrontEndError> {
        let (stamp_ns, camera) = (frame.stamp_ns, self.group.first);
        let first = frame.images.get(&camera).ok_or(FrontEndError::NoImage { camera, stamp_ns })?;
        let image = first.read()?.into_owned();
        let second = self.group.second.and_then(|second| Some((second, frame.images.get(&second)?)));
        let second_image = second.and_then(|(camera, second)| match second.read() {
            Ok(image) => Some(image.into_owned()),
            Err(error) => {
                if let Some(unlogged) = self.second_skipped.note() {
                    tracing::warn!(%error, unlogged, "the image of camera {camera} is skipped");
                }
                None
            }
        });
        let last_ns = self.tracker.last_stamp_ns();
        let seconds = last_ns.map_or(0.0, |last_ns| (stamp_ns - last_ns) as f64 * 1e-9);
        let rotation =
            last_ns.and_then(|last_ns| gyroscope.rotation(&self.imu_from_camera, last_ns, stamp_ns));
        let rate_sigma = RATE_SIGMA[usize::from(gyroscope.bias_is_known)];
        let sigma_rotation_rad = (rate_sigma * seconds).max(MIN_ROTATION_SIGMA);
        let input = TrackerFrame { stamp_ns, image, second_image, rotation, sigma_rotation_rad };
        let pixels = self
            .tracker
            .track(input)
            .map_err(|source| FrontEndError::Tracker { stamp_ns, source: of_rig(source, self.group) })?;
        let rotation_error =
            rotation.zip(self.tracker.report().motion.as_ref()).map(|(predicted, motion)| {
                let error = log(&(motion.current_from_previous * predicted.inverse()));
                (self.imu_from_camera * error, seconds)
            });
        let (number, groups) = self.number;
        let observation = |pixel: &vision::tracking::TrackedPixel| TrackObservation {
            camera: camera_of_rig(pixel.camera, self.group),
            feature_id: pixel.feature_id * groups + number,
            pixel: pixel.pixel,
        };
        Ok(GroupTracks { observations: pixels.iter().map(observation).collect(), rotation_error })
    }
}

/// The index in the rig of a camera of a group, 0 or 1.
fn camera_of_rig(camera: u8, group: CameraGroup) -> u8 {
    (if camera == 0 { group.first } else { group.second.unwrap_or(group.first) }) as u8
}

/// An error that names the camera by its index in the rig.
fn of_rig(error: TrackerError, group: CameraGroup) -> TrackerError {
    match error {
        TrackerError::ImageSize { camera, have, want } => {
            TrackerError::ImageSize { camera: camera_of_rig(camera, group), have, want }
        }
        TrackerError::MaskSize { camera, have, want } => {
            TrackerError::MaskSize { camera: camera_of_rig(camera, group), have, want }
        }
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gyroscope_is_integrated_between_the_images_by_its_own_clock() {
        // The angular rate grows by 1 rad/s each second.
        let reading = |k: i64| ImuSample {
            stamp_ns: k * 5_000_000,
            gyroscope: Vector3::z() * (k as f64 * 5e-3),
            accelerometer: Vector3::zeros(),
        };
        let readings: Vec<ImuSample> = (0..400).map(reading).collect();
        for (time_offset_ns, from_s, to_s) in
            [(0, 1.0, 1.05), (200_000_000, 1.2, 1.25), (-200_000_000, 0.8, 0.85)]
        {
            let gyroscope = GyroscopeNow {
                readings: &readings,
                time_offset_ns,
                bias: Vector3::zeros(),
                bias_is_known: true,
            };
            let rotation = gyroscope.rotation(&Rotation::identity(), 1_000_000_000, 1_050_000_000).unwrap();
            let expected = 0.5 * (from_s * from_s - to_s * to_s);
            assert!((log(&rotation) - Vector3::z() * expected).norm() < 1e-9, "at {time_offset_ns} ns");
        }
    }
}
