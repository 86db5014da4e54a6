//! What an odometry front end reports.

use nalgebra::Vector2;

/// One feature in one image, as an odometry front end reports it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackObservation {
    /// Index of the camera.
    pub camera: u8,
    /// The front end's identity of the feature, the same in all cameras.
    pub feature_id: u64,
    /// Pixel as the camera sees it (distorted).
    pub pixel: Vector2<f64>,
}
