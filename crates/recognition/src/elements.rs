//! Keyframes and landmarks of a loaded map, which refer to each other by index.

use geometry::{Camera, Pose};
use map::model::Keyframe;
use nalgebra::{Vector2, Vector3};
use protocol::LandmarkId;

/// Smallest depth (m) at which a point counts as in front of a camera: less is a division by nearly zero.
const MIN_DEPTH: f64 = 1e-3;

/// A keyframe with the landmarks that it observes.
pub(crate) struct LoadedKeyframe {
    /// Without its features.
    pub(crate) keyframe: Keyframe,
    pub(crate) observed: Vec<ObservedLandmark>,
    /// Descriptors of `observed`, concatenated.
    pub(crate) descriptors: Vec<u8>,
}

/// A landmark as observed by a keyframe.
pub(crate) struct ObservedLandmark {
    /// Index into [`super::loaded_map::LoadedMap::landmarks`].
    pub(crate) landmark: usize,
    pub(crate) pixel: [f32; 2],
    /// In the camera frame of the keyframe, see [`point_in_keyframe`].
    pub(crate) point: Vector3<f64>,
}

/// A landmark without its descriptors.
pub(crate) struct LoadedLandmark {
    pub(crate) id: LandmarkId,
    /// Index into [`super::loaded_map::LoadedMap::keyframes`].
    pub(crate) anchor: usize,
    pub(crate) position_in_anchor: Vector3<f64>,
    /// Index of the keyframe and pixel.
    pub(crate) observations: Vec<(usize, [f32; 2])>,
}

/// A landmark in the camera frame of a keyframe that is not its anchor: on the ray of the keyframe's own pixel, at
/// the depth that the map gives.
///
/// Both keyframe poses are uncertain (0.1 m and 0.9 deg in recorded maps), so the transformed position alone would
/// miss the pixel that the keyframe really observed by tens of pixels. Its direction is known from that pixel, and only
/// its depth must come through the poses.
pub(crate) fn point_in_keyframe(
    camera: &Camera,
    global_from_keyframe: &Pose,
    position_in_global: &Vector3<f64>,
    pixel: [f32; 2],
) -> Vector3<f64> {
    let transformed = global_from_keyframe.inverse_transform(position_in_global);
    match camera.unproject(&Vector2::from(pixel.map(f64::from))) {
        Ok(ray) if transformed.z > MIN_DEPTH => ray.push(1.0) * transformed.z,
        _ => transformed,
    }
}
