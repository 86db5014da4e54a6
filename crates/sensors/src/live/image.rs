//! Images as drivers send them, and their conversion to grey.

use vision::{GrayImage, ImageError, RawImage};

/// An image as it arrives. It is decoded by the thread that reads the source, not by the one that brings it.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum LiveImage {
    /// A PNG or JPEG file.
    Encoded(Vec<u8>),
    /// Pixels, row after row.
    Raw(RawPixels),
    /// Grey pixels.
    Gray(GrayImage),
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

/// Why an image cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LiveImageError {
    /// The image has another size than its camera.
    #[error(
        "an image has {} x {} pixels, but the calibration is for {} x {}: set the driver's resolution, or calibrate again",
        size.0, size.1, calibrated.0, calibrated.1
    )]
    Size {
        /// Its columns and rows.
        size: (u32, u32),
        /// Columns and rows by the calibration.
        calibrated: (u32, u32),
    },
    /// It is damaged, or of an encoding that is not known.
    #[error("an image cannot be decoded: {0}")]
    Undecodable(#[from] ImageError),
}

impl LiveImage {
    /// The grey image. The size is checked before memory is allocated.
    ///
    /// # Arguments
    /// * `calibrated`: columns and rows by the calibration of the camera.
    ///
    /// # Errors
    /// [`LiveImageError`].
    pub fn into_gray(self, calibrated: (u32, u32)) -> Result<GrayImage, LiveImageError> {
        let size = match &self {
            Self::Encoded(bytes) => GrayImage::size_of_encoded(bytes)?,
            Self::Raw(raw) => (raw.width, raw.height),
            Self::Gray(image) => (image.width() as u32, image.height() as u32),
        };
        if size != calibrated {
            return Err(LiveImageError::Size { size, calibrated });
        }
        match self {
            Self::Encoded(bytes) => Ok(GrayImage::decode(&bytes)?),
            Self::Raw(raw) => Ok(raw.to_gray()?),
            Self::Gray(image) => Ok(image),
        }
    }
}

impl RawPixels {
    fn to_gray(&self) -> Result<GrayImage, ImageError> {
        let Self { width, height, step, ref encoding, big_endian, ref bytes } = *self;
        RawImage { encoding, width, height, step, big_endian, data: bytes }.to_gray()
    }
}
