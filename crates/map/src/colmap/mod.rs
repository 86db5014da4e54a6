//! Maps as COLMAP models, which COLMAP, hloc, nerfstudio and others read.
//!
//! A model in COLMAP's text format is three files: `cameras.txt`, `images.txt` (an image a keyframe, world to camera) and
//! `points3D.txt`. Covariances and descriptors have no place in it. COLMAP's pixels count from the corner of the top-left
//! pixel, ours from its centre: 0.5 is added to each.
//!
//! Source: the documentation of COLMAP, "Output format".

#[cfg(test)]
mod tests;
mod write;

pub use write::{ColmapError, write_model};
