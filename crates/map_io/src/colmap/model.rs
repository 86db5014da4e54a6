//! A COLMAP model as it is read.

use super::error::ReadColmapError;
use super::{BINARY_FILES, TEXT_FILES, binary, plain_text};
use geometry::Pose;
use geometry::camera::Camera;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Cameras, images and points of a model, in its own frame and unit of length.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct ColmapModel {
    /// By id.
    pub cameras: BTreeMap<u32, Camera>,
    /// The images with a pose, by id.
    pub images: BTreeMap<u32, ColmapImage>,
    /// Positions of the points, by id.
    pub points: BTreeMap<u64, Vector3<f64>>,
}

/// An image with a pose.
#[derive(Clone, Debug, PartialEq)]
pub struct ColmapImage {
    /// Its file, relative to the folder of images.
    pub name: String,
    /// When it was taken, on the clock of the IMU (ns), where that is known otherwise than by its name. A model says nothing of it.
    pub stamp_ns: Option<i64>,
    /// Id of its camera.
    pub camera: u32,
    /// Pose of the camera in the model's frame, in the model's unit of length.
    pub world_from_camera: Pose,
    /// Where it sees points of the model.
    pub pixels: Vec<ColmapPixel>,
}

/// A point as an image sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ColmapPixel {
    /// Distorted pixel; (0, 0) is the centre of the top-left pixel.
    pub pixel: [f64; 2],
    /// Id of the point.
    pub point: u64,
}

/// Reads a model, in binary where the folder has it, else in text.
///
/// # Example
/// ```no_run
/// let model = map_io::colmap::read_model(std::path::Path::new("sparse/0"))?;
/// println!("{} images, {} points", model.images.len(), model.points.len());
/// # Ok::<(), map_io::colmap::ReadColmapError>(())
/// ```
///
/// # Errors
/// [`ReadColmapError`].
pub fn read_model(folder: &Path) -> Result<ColmapModel, ReadColmapError> {
    let holds = |names: [&str; 3]| names.iter().all(|name| folder.join(name).is_file());
    let model = if holds(BINARY_FILES) {
        binary::read(folder)?
    } else if holds(TEXT_FILES) {
        plain_text::read(folder)?
    } else {
        return Err(ReadColmapError::NoModel { path: folder.to_owned() });
    };
    model.check()?;
    Ok(model)
}

impl ColmapModel {
    fn check(&self) -> Result<(), ReadColmapError> {
        let mut names = BTreeSet::new();
        for image in self.images.values() {
            if !names.insert(&image.name) {
                return Err(ReadColmapError::SameName { name: image.name.clone() });
            }
            let dangling = |what| ReadColmapError::Dangling { image: image.name.clone(), what };
            if !self.cameras.contains_key(&image.camera) {
                return Err(dangling(format!("camera {}", image.camera)));
            }
            if let Some(seen) = image.pixels.iter().find(|seen| !self.points.contains_key(&seen.point)) {
                return Err(dangling(format!("point {}", seen.point)));
            }
        }
        Ok(())
    }
}

/// The pose of a camera from COLMAP's seven numbers, world to camera; `None` where they are no pose.
pub(super) fn pose([w, x, y, z, tx, ty, tz]: [f64; 7]) -> Option<Pose> {
    let quaternion = Quaternion::new(w, x, y, z);
    let translation = Vector3::new(tx, ty, tz);
    let valid = (quaternion.norm() - 1.0).abs() < 1e-3 && translation.iter().all(|value| value.is_finite());
    valid.then(|| Pose::new(UnitQuaternion::new_normalize(quaternion), translation).inverse())
}
