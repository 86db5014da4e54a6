//! Images as files: PNG and JPEG.

use vision::{GrayImage, MAX_PIXELS};

/// An image that is decoded has the size that its header says, and no more pixels than are allowed.
///
/// # Panics
/// It has another.
pub fn images(data: &[u8]) {
    let size = GrayImage::size_of_encoded(data);
    let Ok(image) = GrayImage::decode(data) else { return };
    let decoded = (image.width() as u32, image.height() as u32);
    assert_eq!(size.ok(), Some(decoded));
    assert!(u64::from(decoded.0) * u64::from(decoded.1) <= MAX_PIXELS);
}
