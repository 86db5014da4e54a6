//! Images that people give to the page, to see where they were taken, or why they are not recognized.
//!
//! The viewer checks what it is sent and lets one image through at a time; whoever has the maps searches them.

use crate::queries::ViewedAnswer;
use axum::body::Bytes;
use geometry::Camera;

/// Longest file of an image, bytes.
pub const MAX_IMAGE_BYTES: usize = 4 << 20;

/// The camera that took an image.
#[derive(Clone, Debug)]
pub enum ImageCamera {
    /// One of the map's.
    OfMap(Camera),
    /// A `sensor.yaml` or a camera chain of Kalibr, as text.
    Calibration(String),
}

/// An image that is to be localized.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct GivenImage {
    /// Name of the map.
    pub map: String,
    /// The file; it begins like a PNG or a JPEG image.
    pub file: Bytes,
    /// The camera that took it.
    pub camera: ImageCamera,
}

/// Why an image cannot be searched for in a map. "Not recognized" is an answer, not an error.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ImageError {
    /// The map is not served any more.
    #[error("there is no map {0} any more")]
    UnknownMap(String),
    /// The image, its camera, or the map's features do not allow it.
    #[error("{0}")]
    Unusable(String),
}

/// Searches maps for images.
pub trait LocalizeImage: Send + Sync {
    /// Localizes an image. It is called on a thread that may block, for one image at a time.
    ///
    /// # Errors
    /// [`ImageError`].
    fn localize(&self, image: &GivenImage) -> Result<ViewedAnswer, ImageError>;
}
