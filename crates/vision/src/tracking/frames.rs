//! Input and output of the tracker.

use super::relative_pose::RelativePose;
use crate::image::GrayImage;
use geometry::Rotation;
use nalgebra::Vector2;

/// The input of the tracker at one time.
#[derive(Clone, Debug)]
pub struct TrackerFrame {
    /// Timestamp, nanoseconds.
    pub stamp_ns: i64,
    /// Image of the first camera.
    pub image: GrayImage,
    /// Image of the second camera at the same time.
    pub second_image: Option<GrayImage>,
    /// Rotation of the first camera since the previous image, `current_from_previous`, if a gyroscope measured it.
    pub rotation: Option<Rotation>,
    /// Standard deviation of the rotation, radians; mostly gyroscope bias times the interval.
    pub sigma_rotation_rad: f64,
}

/// A tracked point in an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackedPixel {
    /// Index of the camera, 0 or 1.
    pub camera: u8,
    /// Identifier of the point, the same in both cameras; never reused.
    pub feature_id: u64,
    /// Distorted pixel.
    pub pixel: Vector2<f64>,
}

/// Statistics of one image.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct TrackerReport {
    /// Tracks of the previous image that were continued.
    pub continued: usize,
    /// Tracks that were not found, left the image, entered the mask or merged with another track.
    pub lost: usize,
    /// Tracks rejected as outliers of the relative pose.
    pub outliers: usize,
    /// New tracks.
    pub started: usize,
    /// Tracks matched in the second camera.
    pub stereo: usize,
    /// Relative pose since the previous image, estimated from the inliers.
    pub motion: Option<RelativePose>,
    /// Median angle between observed bearings and those predicted by the rotation alone, radians.
    pub parallax: Option<f64>,
}

/// Why an image was rejected. The tracker is unchanged.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum TrackerError {
    /// The image size differs from the calibration.
    #[error(
        "camera {camera}: the image has {have:?} pixels, the calibration says {want:?}: do the images belong to this \
         sensor.yaml?"
    )]
    ImageSize {
        /// Index of the camera.
        camera: u8,
        /// Width and height of the image.
        have: [usize; 2],
        /// Width and height of the calibration.
        want: [usize; 2],
    },
    /// The mask size differs from the calibration.
    #[error("camera {camera}: the mask has {have:?} pixels, the calibration says {want:?}")]
    MaskSize {
        /// Index of the camera.
        camera: u8,
        /// Width and height of the mask.
        have: [usize; 2],
        /// Width and height of the calibration.
        want: [usize; 2],
    },
    /// The image is not newer than the previous one.
    #[error("the image of {stamp_ns} ns is not newer than the previous one ({last_ns} ns)")]
    OldImage {
        /// Its timestamp.
        stamp_ns: i64,
        /// Timestamp of the previous image.
        last_ns: i64,
    },
}
