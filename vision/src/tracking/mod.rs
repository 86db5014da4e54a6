//! Following points from image to image.
mod block;
pub mod lucas_kanade;
mod template;

pub use lucas_kanade::{AlignmentOptions, Found, Lost, Warp, align, align_mutually};
pub(crate) use template::smaller_eigenvalue;
