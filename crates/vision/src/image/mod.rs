//! Grey images: reading and writing them, pyramids, and histogram equalization.

pub mod equalization;
mod gray;
mod marks;
pub mod pyramid;
mod raw;
mod second_differences;
mod structure;

pub use equalization::{Equalization, LocalEqualization, equalize, equalize_locally};
pub use gray::{GrayImage, ImageError, MAX_IMAGE_FILE_BYTES, MAX_IMAGE_SIDE, MAX_PIXELS, MAX_SCANS};
pub(crate) use marks::marked;
pub use pyramid::Pyramid;
pub use raw::RawImage;
pub(crate) use second_differences::second_differences;
