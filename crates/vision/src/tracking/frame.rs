//! What goes into the tracker and what comes out of it.

use super::relative_pose::RelativePose;
use crate::image::GrayImage;
use geometry::Rotation;
use nalgebra::Vector2;

/// One instant for the tracker.
#[derive(Clone, Debug)]
pub struct TrackerFrame {
    /// Time, nanoseconds.
    pub stamp_ns: i64,
    /// What the first camera saw.
    pub image: GrayImage,
    /// What the second camera saw at the same time.
    pub second_image: Option<GrayImage>,
    /// How the first camera turned since the image before, where a gyroscope knows: `current_from_previous`.
    pub rotation: Option<Rotation>,
    /// How well it is known, standard deviation, radians: the gyroscope's bias times the time, mostly.
    pub rotation_sigma: f64,
}

/// A tracked point in an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackedPixel {
    /// 0 or 1.
    pub camera: u8,
    /// Name of the point, the same in both cameras; never used again for another one.
    pub feature_id: u64,
    /// Where, pixels as the camera saw them (distorted).
    pub pixel: Vector2<f64>,
}

/// What happened to the tracks at one image.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TrackerReport {
    /// Tracks of the image before that were continued.
    pub continued: usize,
    /// That were not found again, or left the image, or ran into a mask or into each other.
    pub lost: usize,
    /// That did not move with the scene.
    pub outliers: usize,
    /// New ones.
    pub begun: usize,
    /// Seen by the second camera as well.
    pub stereo: usize,
    /// The motion that the tracks agree on, since the image before.
    pub motion: Option<RelativePose>,
    /// Median angle between where points are and where the rotation alone would have put them, radians.
    pub parallax: Option<f64>,
}

/// Why an image was not taken. The tracker stays as it was.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TrackerError {
    /// The image is not of the camera.
    #[error(
        "camera {camera}: the image has {have:?} pixels, its calibration says {want:?}: images and sensor.yaml do not \
         belong together"
    )]
    ImageSize {
        /// Which camera.
        camera: u8,
        /// Width and height of the image.
        have: [usize; 2],
        /// Width and height of the calibration.
        want: [usize; 2],
    },
    /// The mask is not of the camera.
    #[error("camera {camera}: the mask has {have:?} pixels, the camera {want:?}")]
    MaskSize {
        /// Which camera.
        camera: u8,
        /// Width and height of the mask.
        have: [usize; 2],
        /// Width and height of the calibration.
        want: [usize; 2],
    },
    /// The image is not newer than the one before.
    #[error("the image of {stamp_ns} ns is not newer than the one before ({last_ns} ns)")]
    OldImage {
        /// Its time.
        stamp_ns: i64,
        /// Time of the one before.
        last_ns: i64,
    },
}
