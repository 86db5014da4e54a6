//! What a start in motion has to go by: a second or two of images and the IMU readings in between.

use super::NotYet;
use crate::calibration::CalibratedCamera;
use crate::imu::{ImuBuffer, Readings};
use crate::odometry::tracks::TrackObservation;
use nalgebra::{Vector2, Vector3};
use std::collections::BTreeMap;

/// Most tracks of a window. More cost time and tell little: the IMU limits the start, not the pixels.
const MOST_TRACKS: usize = 100;
/// Images that a track must have been seen in. Three rays leave a residual to judge by.
const LEAST_IMAGES: usize = 4;
/// How long a reading may be held at an end of the window, nanoseconds.
const IMU_SLACK_NS: i64 = 20_000_000;

/// One image and what was tracked in it.
#[derive(Clone, Debug, PartialEq)]
pub struct StartImage {
    /// Time, nanoseconds.
    pub stamp_ns: i64,
    /// Tracks of all cameras of the rig.
    pub tracks: Vec<TrackObservation>,
}

/// One feature in one image of the window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StartSighting {
    /// Place of the image in the window, oldest first.
    pub image: usize,
    /// Camera of the rig.
    pub camera: usize,
    /// Where, distorted pixels.
    pub pixel: Vector2<f64>,
    /// The ray in the camera, `(x / z, y / z, 1)`.
    pub ray: Vector3<f64>,
}

/// A feature that was seen without a gap, oldest sighting first.
pub type StartTrack = Vec<StartSighting>;

/// Images, readings between them, and the tracks that connect them.
#[derive(Clone, Debug, PartialEq)]
pub struct Window {
    /// Times of the images, nanoseconds, oldest first.
    pub stamps_ns: Vec<i64>,
    /// `readings[k]` lead from image k to image k + 1.
    pub readings: Vec<Readings>,
    /// The longest tracks.
    pub tracks: Vec<StartTrack>,
}

impl Window {
    /// Puts a window together.
    ///
    /// # Arguments
    /// * `images`: oldest first.
    /// * `imu`: readings that reach from before the first to the last of them.
    ///
    /// # Errors
    /// [`NotYet::TooFewImages`], [`NotYet::NoImu`] where readings are missing.
    pub fn new(images: &[StartImage], imu: &ImuBuffer, rig: &[CalibratedCamera]) -> Result<Self, NotYet> {
        if images.len() < LEAST_IMAGES {
            return Err(NotYet::TooFewImages { have: images.len(), need: LEAST_IMAGES });
        }
        let mut readings = Vec::with_capacity(images.len() - 1);
        for pair in images.windows(2) {
            let between = imu.interval(pair[0].stamp_ns, pair[1].stamp_ns, IMU_SLACK_NS);
            readings.push(between.map_err(|_| NotYet::NoImu)?);
        }
        let stamps_ns = images.iter().map(|image| image.stamp_ns).collect();
        Ok(Self { stamps_ns, readings, tracks: longest_tracks(images, rig) })
    }

    /// Time from the first image to image `k`, seconds.
    pub fn seconds(&self, k: usize) -> f64 {
        (self.stamps_ns[k] - self.stamps_ns[0]) as f64 * 1e-9
    }
}

/// The tracks that were seen in the most images; of equals those of the smaller name.
fn longest_tracks(images: &[StartImage], rig: &[CalibratedCamera]) -> Vec<StartTrack> {
    let mut running: BTreeMap<u64, StartTrack> = BTreeMap::new();
    let mut tracks: Vec<StartTrack> = Vec::new();
    for (image, seen) in images.iter().enumerate() {
        for observation in &seen.tracks {
            let camera = usize::from(observation.camera);
            let Some(eye) = rig.get(camera) else { continue };
            let Ok(ray) = eye.camera.unproject(&observation.pixel) else { continue };
            let ray = Vector3::new(ray.x, ray.y, 1.0);
            let track = running.entry(observation.feature_id).or_default();
            // A name that comes back after a gap is another track.
            if track.last().is_some_and(|last| last.image + 1 < image) {
                tracks.push(std::mem::take(track));
            }
            track.push(StartSighting { image, camera, pixel: observation.pixel, ray });
        }
    }
    tracks.extend(running.into_values());
    tracks.retain(|track| images_of(track) >= LEAST_IMAGES);
    tracks.sort_by_key(|track| std::cmp::Reverse(images_of(track)));
    tracks.truncate(MOST_TRACKS);
    tracks
}

/// How many images a track was seen in. All its images follow each other.
pub fn images_of(track: &[StartSighting]) -> usize {
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
        let rig = [CalibratedCamera { camera, imu_from_camera: Pose::identity() }];
        let seen: [&[u64]; 10] =
            [&[1, 2], &[1, 2], &[1, 2], &[1, 2], &[1], &[1, 2], &[1, 2], &[1, 2], &[1, 2], &[1, 2]];
        let images: Vec<StartImage> = (0..)
            .zip(seen)
            .map(|(k, ids)| StartImage {
                stamp_ns: k * 100_000_000,
                tracks: ids
                    .iter()
                    .map(|&feature_id| TrackObservation { camera: 0, feature_id, pixel: Vector2::zeros() })
                    .collect(),
            })
            .collect();
        let mut imu = ImuBuffer::default();
        assert_eq!(Window::new(&images, &imu, &rig), Err(NotYet::NoImu));
        for k in 0..=100 {
            let zero = Vector3::zeros();
            imu.push(crate::ImuSample { stamp_ns: k * 10_000_000, gyroscope: zero, accelerometer: zero })
                .unwrap();
        }
        let window = Window::new(&images, &imu, &rig).unwrap();
        let lengths: Vec<usize> = window.tracks.iter().map(|track| images_of(track)).collect();
        assert_eq!(lengths, [10, 5, 4]);
        assert_eq!(window.readings.len(), 9);
        let short = Window::new(&images[..3], &imu, &rig);
        assert_eq!(short, Err(NotYet::TooFewImages { have: 3, need: 4 }));
    }
}
