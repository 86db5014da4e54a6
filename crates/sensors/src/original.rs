//! Images as their sensors gave them, before they were decoded to grey.

use vision::{GrayImage, ImageError, RawImage};

/// An image as its sensor gave it: what a recording keeps.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum OriginalImage {
    /// A PNG or JPEG file.
    Encoded(Vec<u8>),
    /// Pixels, row after row.
    Raw(RawPixels),
}

/// The grey pixels of an image beside what they were made of.
#[derive(Clone, Debug, PartialEq)]
pub struct DecodedImage {
    /// Grey pixels.
    pub gray: GrayImage,
    /// What they were made of.
    pub original: OriginalImage,
}

/// Pixels as a driver gives them: [`vision::RawImage`] with its bytes.
#[derive(Clone, Debug, PartialEq)]
pub struct RawPixels {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Bytes from the begin of a row to that of the next.
    pub step: u32,
    /// What the bytes are, by the names of ROS.
    pub encoding: String,
    /// Whether the upper byte of 16 bits comes first.
    pub big_endian: bool,
    /// `height` times `step` of them; the last row may end with its last pixel.
    pub bytes: Vec<u8>,
}

impl RawPixels {
    pub(crate) fn to_gray(&self) -> Result<GrayImage, ImageError> {
        let Self { width, height, step, ref encoding, big_endian, ref bytes } = *self;
        RawImage { encoding, width, height, step, big_endian, data: bytes }.to_gray()
    }
}
