//! The cameras that a map was built with, one of which may have taken an image that is to be localized.

use geometry::Camera;
use serde::Serialize;

/// Cameras of a map that are offered; of a model in which each image has its own, the first.
const MAX_CAMERAS: usize = 64;

/// A camera of a map.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ViewedCamera {
    pub(crate) camera: Camera,
    /// Keyframes that it took.
    pub(crate) keyframes: usize,
}

/// A camera in an answer.
#[derive(Debug, Serialize)]
pub(crate) struct CameraAnswer {
    /// Its place in the list.
    number: usize,
    keyframes: usize,
    /// Pixels.
    width: u32,
    height: u32,
    focal: [f64; 2],
    centre: [f64; 2],
    distortion_model: &'static str,
    distortion_coefficients: Vec<f64>,
}

impl CameraAnswer {
    pub(crate) fn of((number, viewed): (usize, &ViewedCamera)) -> Self {
        let Camera { width, height, focal, centre, distortion } = &viewed.camera;
        let (distortion_model, distortion_coefficients) = (distortion.name(), distortion.coefficients());
        let (width, height, focal, centre) = (*width, *height, *focal, *centre);
        let keyframes = viewed.keyframes;
        Self { number, keyframes, width, height, focal, centre, distortion_model, distortion_coefficients }
    }
}

/// The different cameras among those of all keyframes, most frequent first.
pub(crate) fn cameras_of<'a>(cameras: impl Iterator<Item = &'a Camera>) -> Vec<ViewedCamera> {
    counted(cameras.map(|camera| (camera, 1)))
}

/// The different cameras of parts of a map, most frequent first.
pub(crate) fn joined_cameras<'a>(parts: impl Iterator<Item = &'a ViewedCamera>) -> Vec<ViewedCamera> {
    counted(parts.map(|viewed| (&viewed.camera, viewed.keyframes)))
}

fn counted<'a>(cameras: impl Iterator<Item = (&'a Camera, usize)>) -> Vec<ViewedCamera> {
    let mut found: Vec<ViewedCamera> = Vec::new();
    for (camera, keyframes) in cameras {
        // Neighbours mostly have the same one, which is the last that was found.
        if let Some(known) = found.iter_mut().rev().find(|known| known.camera == *camera) {
            known.keyframes += keyframes;
        } else if found.len() < MAX_CAMERAS {
            found.push(ViewedCamera { camera: camera.clone(), keyframes });
        }
    }
    found.sort_by_key(|camera| std::cmp::Reverse(camera.keyframes));
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::Distortion;

    fn camera(width: u32) -> Camera {
        let (focal, centre) = ([400.0, 400.0], [f64::from(width) / 2.0, 200.0]);
        Camera { width, height: 400, focal, centre, distortion: Distortion::Fov(0.9) }
    }

    #[test]
    fn the_camera_of_most_keyframes_is_first() {
        let all: Vec<Camera> = [600, 640, 640, 600, 640, 800].map(camera).into();
        let found = cameras_of(all.iter());
        assert_eq!(
            found.iter().map(|one| (one.camera.width, one.keyframes)).collect::<Vec<_>>(),
            [(640, 3), (600, 2), (800, 1)]
        );
        assert_eq!(CameraAnswer::of((0, &found[0])).distortion_coefficients, [0.9]);
    }

    #[test]
    fn a_camera_for_each_keyframe_does_not_make_an_endless_list() {
        let all: Vec<Camera> = (100..1000).map(camera).collect();
        assert_eq!(cameras_of(all.iter()).len(), MAX_CAMERAS);
    }
}
