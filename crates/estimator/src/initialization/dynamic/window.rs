//! The measurements of a dynamic initialization: images of one or two seconds and the IMU samples in between.

use super::error::DynamicInitError;
use crate::calibration::{CalibratedCamera, row_reach_ns};
use crate::imu::{ImuBuffer, Readings};
use crate::rolling_shutter::still_pixel::{still_pixel, turn_around};
use nalgebra::{Vector2, Vector3};
use std::collections::BTreeMap;
use types::TrackObservation;

/// Maximum number of tracks. More cost time and gain little: the IMU limits the accuracy, not the pixels.
const MAX_TRACKS: usize = 100;
/// Minimum number of tracks of a dynamic initialization.
pub const MIN_TRACKS: usize = 15;
/// Minimum number of images of a track. Three bearings give a residual.
const MIN_IMAGES: usize = 4;
/// Maximum time by which the IMU samples may begin or end within the window, nanoseconds.
const IMU_SLACK_NS: i64 = 20_000_000;

/// Longest time between two samples in the window, nanoseconds.
const MAX_GAP_NS: i64 = 100_000_000;

/// One image with its tracks.
#[derive(Clone, Debug, PartialEq)]
pub struct WindowImage {
    /// Time, nanoseconds.
    pub stamp_ns: i64,
    /// Observations of all cameras.
    pub tracks: Vec<TrackObservation>,
}

/// One feature in one image of the window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WindowObservation {
    /// Index of the image in the window, oldest first.
    pub image: usize,
    /// Index of the camera.
    pub camera: usize,
    /// Pixel as the camera sees it (distorted).
    pub pixel: Vector2<f64>,
    /// Bearing in the camera frame, `(x / z, y / z, 1)`.
    pub ray: Vector3<f64>,
}

/// The observations of a feature in consecutive images, oldest first.
pub type WindowTrack = Vec<WindowObservation>;

/// Images, the IMU samples between them, and their tracks.
#[derive(Clone, Debug, PartialEq)]
pub struct Window {
    /// Times of the images, nanoseconds, oldest first.
    pub stamps_ns: Vec<i64>,
    /// `readings[k]` are the IMU samples from image k to image k + 1.
    pub readings: Vec<Readings>,
    /// The longest tracks.
    pub tracks: Vec<WindowTrack>,
}

impl Window {
    /// Collects tracks and IMU samples.
    ///
    /// # Arguments
    /// * `images`: oldest first.
    /// * `imu`: samples from before the first to the last of them.
    ///
    /// # Errors
    /// [`DynamicInitError::TooFewImages`], [`DynamicInitError::NoImu`].
    pub fn new(
        images: &[WindowImage],
        imu: &ImuBuffer,
        cameras: &[CalibratedCamera],
    ) -> Result<Self, DynamicInitError> {
        if images.len() < MIN_IMAGES {
            return Err(DynamicInitError::TooFewImages { have: images.len(), need: MIN_IMAGES });
        }
        // Images cut a gap, and nobody would know how the body moved in it.
        if imu.longest_gap_ns(images[0].stamp_ns, images[images.len() - 1].stamp_ns) > MAX_GAP_NS {
            return Err(DynamicInitError::NoImu);
        }
        let mut readings = Vec::with_capacity(images.len() - 1);
        for pair in images.windows(2) {
            let between = imu.interval(pair[0].stamp_ns, pair[1].stamp_ns, IMU_SLACK_NS);
            readings.push(between.map_err(|_| DynamicInitError::NoImu)?);
        }
        let stamps_ns = images.iter().map(|image| image.stamp_ns).collect();
        let tracks = match row_reach_ns(cameras) {
            0 => longest_tracks(images, cameras),
            reach_ns => longest_tracks(&without_turn(images, imu, cameras, reach_ns), cameras),
        };
        Ok(Self { stamps_ns, readings, tracks })
    }

    /// Time from the first image to image `k`, seconds.
    pub fn seconds(&self, k: usize) -> f64 {
        (self.stamps_ns[k] - self.stamps_ns[0]) as f64 * 1e-9
    }
}

/// The images as cameras with a rolling shutter would have seen them without turning during the readout.
fn without_turn(
    images: &[WindowImage],
    imu: &ImuBuffer,
    cameras: &[CalibratedCamera],
    reach_ns: i64,
) -> Vec<WindowImage> {
    let still = |image: &WindowImage| {
        let motion = turn_around(imu, image.stamp_ns, reach_ns, &Vector3::zeros());
        let mut still = image.clone();
        for track in &mut still.tracks {
            if let Some(calibrated) = cameras.get(usize::from(track.camera)) {
                track.pixel = still_pixel(calibrated, &motion, &track.pixel);
            }
        }
        still
    };
    images.iter().map(still).collect()
}

/// The tracks with the most images; among equals those of the smaller feature.
fn longest_tracks(images: &[WindowImage], cameras: &[CalibratedCamera]) -> Vec<WindowTrack> {
    let mut running: BTreeMap<u64, WindowTrack> = BTreeMap::new();
    let mut tracks: Vec<WindowTrack> = Vec::new();
    for (image, seen) in images.iter().enumerate() {
        for observation in &seen.tracks {
            let camera = usize::from(observation.camera);
            let Some(calibrated) = cameras.get(camera) else { continue };
            let Ok(ray) = calibrated.camera.unproject(&observation.pixel) else { continue };
            let ray = Vector3::new(ray.x, ray.y, 1.0);
            let track = running.entry(observation.feature_id).or_default();
            // A feature observed again after a gap is another track.
            if track.last().is_some_and(|last| last.image + 1 < image) {
                tracks.push(std::mem::take(track));
            }
            track.push(WindowObservation { image, camera, pixel: observation.pixel, ray });
        }
    }
    tracks.extend(running.into_values());
    tracks.retain(|track| images_of(track) >= MIN_IMAGES);
    tracks.sort_by_key(|track| std::cmp::Reverse(images_of(track)));
    tracks.truncate(MAX_TRACKS);
    tracks
}

/// Number of images of a track, which are consecutive.
pub fn images_of(track: &[WindowObservation]) -> usize {
    match (track.first(), track.last()) {
        (Some(first), Some(last)) => last.image - first.image + 1,
        _ => 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::{Camera, Distortion, Pose};

    #[test]
    fn a_track_ends_at_a_gap_and_short_ones_are_left_out() {
        let camera = Camera {
            width: 640,
            height: 480,
            focal: [400.0; 2],
            centre: [320.0, 240.0],
            distortion: Distortion::None,
        };
        let cameras = [CalibratedCamera::new(camera, Pose::identity())];
        let seen: [&[u64]; 10] =
            [&[1, 2], &[1, 2], &[1, 2], &[1, 2], &[1], &[1, 2], &[1, 2], &[1, 2], &[1, 2], &[1, 2]];
        let images: Vec<WindowImage> = (0..)
            .zip(seen)
            .map(|(k, ids)| WindowImage {
                stamp_ns: k * 100_000_000,
                tracks: ids
                    .iter()
                    .map(|&feature_id| TrackObservation { camera: 0, feature_id, pixel: Vector2::zeros() })
                    .collect(),
            })
            .collect();
        let mut imu = ImuBuffer::default();
        assert_eq!(Window::new(&images, &imu, &cameras), Err(DynamicInitError::NoImu));
        for k in 0..=100 {
            let zero = Vector3::zeros();
            imu.push(crate::ImuSample { stamp_ns: k * 10_000_000, gyroscope: zero, accelerometer: zero })
                .unwrap();
        }
        let window = Window::new(&images, &imu, &cameras).unwrap();
        let lengths: Vec<usize> = window.tracks.iter().map(|track| images_of(track)).collect();
        assert_eq!(lengths, [10, 5, 4]);
        assert_eq!(window.readings.len(), 9);
        let short = Window::new(&images[..3], &imu, &cameras);
        assert_eq!(short, Err(DynamicInitError::TooFewImages { have: 3, need: 4 }));
    }
}
