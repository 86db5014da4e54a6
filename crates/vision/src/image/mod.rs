//! Grey images: reading and writing them, pyramids, and histogram equalization.

mod completeness;
pub mod equalization;
mod gray;
mod marks;
pub mod pyramid;
mod raw;

pub use equalization::{Equalization, LocalEqualization, equalize, equalize_locally};
pub use gray::{GrayImage, ImageError};
pub(crate) use marks::marked;
pub use pyramid::Pyramid;
pub use raw::RawImage;
