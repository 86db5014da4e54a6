//! Why a COLMAP model cannot be written or read.

use map::contents::ContentsError;
use std::path::PathBuf;

/// Why a model cannot be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ColmapError {
    /// The map violates an invariant.
    #[error("the map is invalid: {0}")]
    Contents(#[from] ContentsError),
    /// The folder holds a model already.
    #[error("{} holds a COLMAP model already: give another folder", path.display())]
    Occupied {
        /// The folder.
        path: PathBuf,
    },
    /// Two keyframes have one name.
    #[error("two keyframes have the image {name}: the model would name it twice")]
    SameName {
        /// The name.
        name: String,
    },
    /// A camera of a model that COLMAP does not have.
    #[error(
        "COLMAP has no camera model for the distortion {model} with its coefficients: it has pinhole, radial-tangential without a thin prism, \
         equidistant, fov and thin-prism-fisheye"
    )]
    CameraModel {
        /// Name of the distortion.
        model: &'static str,
    },
    /// A file or folder could not be written.
    #[error("cannot write {}: {reason}; check the folder's rights and free space", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The error of the system.
        reason: std::io::Error,
    },
}

/// Why a model cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReadColmapError {
    /// The folder holds no model.
    #[error(
        "{} holds no COLMAP model: cameras, images and points3D are needed, all .bin or all .txt",
        path.display()
    )]
    NoModel {
        /// The folder.
        path: PathBuf,
    },
    /// A file cannot be read.
    #[error("cannot read {}: {reason}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The error of the system.
        reason: std::io::Error,
    },
    /// A file ends early, or holds what no model holds.
    #[error("{} is damaged at {position}: {problem}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The line or byte.
        position: String,
        /// What is wrong.
        problem: String,
    },
    /// A camera of a model that has no counterpart here.
    #[error(
        "camera {camera} has the model {model}, which is not supported: convert it with `colmap model_converter` or \
         undistort the images (supported are PINHOLE, RADIAL, OPENCV, FULL_OPENCV, FOV, OPENCV_FISHEYE, THIN_PRISM_FISHEYE and their \
         simple forms)"
    )]
    CameraModel {
        /// Id of the camera.
        camera: u32,
        /// Name or number of its model.
        model: String,
    },
    /// The parameters of a camera are impossible.
    #[error("camera {camera} is invalid: {problem}")]
    Camera {
        /// Id of the camera.
        camera: u32,
        /// What is wrong.
        problem: geometry::CameraError,
    },
    /// Two images have one name.
    #[error(
        "two images of the model are called {name}: give each its own name, with its folder where there are several cameras \
         (cam0/NAME, cam1/NAME), or remove one with `colmap image_deleter`"
    )]
    SameName {
        /// The name.
        name: String,
    },
    /// An image names a camera or point that the model does not have.
    #[error("image {image} names {what}, which the model does not have: is it one model's files?")]
    Dangling {
        /// Name of the image.
        image: String,
        /// What it names.
        what: String,
    },
}
