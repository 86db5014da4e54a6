//! Maps as COLMAP models, which COLMAP, hloc, nerfstudio and others read, and models of COLMAP as a basis of maps.
//!
//! A model is three files, in text or binary: `cameras`, `images` (an image a keyframe, world to camera) and `points3D`;
//! newer versions add `rigs` and `frames`, which repeat the poses of the images. Covariances and descriptors have no place
//! in it. COLMAP's pixels count from the corner of the top-left pixel, ours from its centre: 0.5 is added on writing and
//! subtracted on reading.
//!
//! Source: the documentation of COLMAP, "Output format".

mod binary;
mod camera_model;
mod error;
mod model;
mod names;
mod plain_text;
#[cfg(test)]
mod tests;
mod write;

pub use error::{ColmapError, ReadColmapError};
pub use model::{ColmapImage, ColmapModel, ColmapPixel, read_model};
pub use names::image_names;
pub use write::{WrittenModel, write_model};

/// From our pixels to COLMAP's.
const PIXEL_OFFSET: f64 = 0.5;
/// The files of a model in text.
const TEXT_FILES: [&str; 3] = ["cameras.txt", "images.txt", "points3D.txt"];
/// The files of a model in binary.
const BINARY_FILES: [&str; 3] = ["cameras.bin", "images.bin", "points3D.bin"];
