//! The place of an image, in short.

use geometry::PoseWithCovariance;

/// A place that explains an image.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct RecognizedPlace {
    /// The camera in G (rad, m) by the keyframe with most inliers.
    pub global_from_camera: PoseWithCovariance,
    /// Query features that it explains.
    pub features: usize,
}

impl RecognizedPlace {
    /// A place that was recognized elsewhere.
    pub fn new(global_from_camera: PoseWithCovariance, features: usize) -> Self {
        Self { global_from_camera, features }
    }
}
