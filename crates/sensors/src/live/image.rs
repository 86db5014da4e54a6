//! Images as drivers send them, and their conversion to grey.

use crate::{DecodedImage, ImageData, OriginalImage, RawPixels};
use std::sync::Arc;
use vision::{GrayImage, ImageError};

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
        self.check_size(calibrated)?;
        match self {
            Self::Encoded(bytes) => Ok(GrayImage::decode(&bytes)?),
            Self::Raw(raw) => Ok(raw.to_gray()?),
            Self::Gray(image) => Ok(image),
        }
    }

    /// The grey image beside what came, for a [`Frame`](crate::Frame).
    ///
    /// # Errors
    /// As [`LiveImage::into_gray`].
    pub fn into_image(self, calibrated: (u32, u32)) -> Result<ImageData, LiveImageError> {
        self.check_size(calibrated)?;
        let (gray, original) = match self {
            Self::Encoded(bytes) => (GrayImage::decode(&bytes)?, OriginalImage::Encoded(bytes)),
            Self::Raw(raw) => (raw.to_gray()?, OriginalImage::Raw(raw)),
            Self::Gray(image) => return Ok(image.into()),
        };
        Ok(ImageData::Decoded(Arc::new(DecodedImage { gray, original })))
    }

    fn check_size(&self, calibrated: (u32, u32)) -> Result<(), LiveImageError> {
        let size = match self {
            Self::Encoded(bytes) => GrayImage::size_of_encoded(bytes)?,
            Self::Raw(raw) => (raw.width, raw.height),
            Self::Gray(image) => (image.width() as u32, image.height() as u32),
        };
        if size == calibrated { Ok(()) } else { Err(LiveImageError::Size { size, calibrated }) }
    }
}
