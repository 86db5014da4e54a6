//! Corner detection, distributed over the image by a grid.
//!
//! The image is divided into grid cells. Cells that have fewer points than their quota are searched for corners
//! (gradients in two directions); the strongest of each cell are taken, not too close to each other or to points that
//! are tracked already.
//!
//! Source: Shi & Tomasi, "Good features to track", CVPR 1994: the score is the smaller eigenvalue of the mean of
//! `gradient * gradient'` over a small window.

mod corner;
mod detector;
mod grid;
mod noise;
pub(crate) mod score;
pub(crate) mod spacing;

pub use corner::{Corner, CornerOptions};
pub use detector::detect_corners;
