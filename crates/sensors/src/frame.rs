//! What the cameras of a robot give at one instant.

use super::TrackObservation;
use super::original::{DecodedImage, OriginalImage};
use protocol::FeatureSet;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use vision::{GrayImage, ImageError, MAX_IMAGE_FILE_BYTES};

/// All that the cameras give at one instant. Every part is optional: a recording may hold images, or what a front
/// end made of them, or both.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Frame {
    /// Time of exposure on the clock of the cameras, nanoseconds. A calibrated offset to the IMU's clock (Kalibr's
    /// `timeshift_cam_imu` of camera 0) is added already; what remains is the estimator's to estimate, and by how much images of other cameras are
    /// later is `CameraSensor::delay_s`.
    pub stamp_ns: i64,
    /// The images by the index of their camera; cameras that were not triggered, or whose image is lost, are missing.
    pub images: BTreeMap<usize, ImageData>,
    /// Tracked points (pixels); empty where nothing was tracked.
    pub tracks: Vec<TrackObservation>,
    /// Features of images for place recognition by the index of their camera, of those of which they were extracted.
    pub features: BTreeMap<usize, FeatureSet>,
}

/// An image, or where to read it. Clones share the pixels.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum ImageData {
    /// A PNG or JPEG file, decoded when it is needed.
    File(PathBuf),
    /// Decoded pixels.
    Pixels(Arc<GrayImage>),
    /// Decoded pixels, and the image as the sensor gave it.
    Decoded(Arc<DecodedImage>),
    /// An image in a bag, read and decoded when it is needed.
    Stored(Arc<dyn StoredImage>),
}

/// An image that is neither a file nor in memory, as one in a bag.
pub trait StoredImage: fmt::Debug + Send + Sync {
    /// What it is called in messages; different for every image.
    fn name(&self) -> String;

    /// Reads and decodes it.
    ///
    /// # Errors
    /// [`ImageError`]: it cannot be read or decoded.
    fn read(&self) -> Result<GrayImage, ImageError>;

    /// The image as the sensor gave it; `None` where there are only grey pixels.
    ///
    /// # Errors
    /// [`ImageError`]: it cannot be read.
    fn original(&self) -> Result<Option<OriginalImage>, ImageError> {
        Ok(None)
    }
}

impl PartialEq for dyn StoredImage {
    fn eq(&self, other: &Self) -> bool {
        self.name() == other.name()
    }
}

impl ImageData {
    /// The grey image; what is not in memory is read and decoded.
    ///
    /// # Errors
    /// [`ImageError`]: it cannot be read or decoded.
    ///
    /// ```
    /// let image = vision::GrayImage::from_fn(4, 3, |x, y| (10 * y + x) as u8);
    /// assert_eq!(*sensors::ImageData::from(image.clone()).read()?, image);
    /// # Ok::<(), vision::ImageError>(())
    /// ```
    pub fn read(&self) -> Result<Cow<'_, GrayImage>, ImageError> {
        match self {
            Self::File(path) => GrayImage::read(path).map(Cow::Owned),
            Self::Pixels(image) => Ok(Cow::Borrowed(image)),
            Self::Decoded(image) => Ok(Cow::Borrowed(&image.gray)),
            Self::Stored(image) => image.read().map(Cow::Owned),
        }
    }

    /// The image as the sensor gave it, not decoded; `None` where there are only grey pixels.
    ///
    /// # Errors
    /// [`ImageError`]: it cannot be read.
    pub fn original(&self) -> Result<Option<Cow<'_, OriginalImage>>, ImageError> {
        match self {
            Self::File(path) => {
                let name = || path.display().to_string();
                let bytes = files::read(path, MAX_IMAGE_FILE_BYTES)
                    .map_err(|source| ImageError::Source { name: name(), source: source.into() })?;
                Ok(Some(Cow::Owned(OriginalImage::Encoded(bytes))))
            }
            Self::Pixels(_) => Ok(None),
            Self::Decoded(image) => Ok(Some(Cow::Borrowed(&image.original))),
            Self::Stored(image) => Ok(image.original()?.map(Cow::Owned)),
        }
    }

    /// Columns and rows, of a file from its header.
    ///
    /// # Errors
    /// As [`ImageData::read`].
    pub fn size(&self) -> Result<(u32, u32), ImageError> {
        if let Self::File(path) = self {
            return GrayImage::size_of_file(path);
        }
        self.read().map(|image| (image.width() as u32, image.height() as u32))
    }

    /// The file, where the image is one.
    pub fn path(&self) -> Option<&Path> {
        match self {
            Self::File(path) => Some(path),
            Self::Pixels(_) | Self::Decoded(_) | Self::Stored(_) => None,
        }
    }
}

impl fmt::Display for ImageData {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(path) => path.display().fmt(formatter),
            Self::Pixels(image) => write_size(formatter, image),
            Self::Decoded(image) => write_size(formatter, &image.gray),
            Self::Stored(image) => formatter.write_str(&image.name()),
        }
    }
}

fn write_size(formatter: &mut fmt::Formatter<'_>, image: &GrayImage) -> fmt::Result {
    write!(formatter, "an image of {} x {} pixels", image.width(), image.height())
}

impl From<PathBuf> for ImageData {
    fn from(path: PathBuf) -> Self {
        Self::File(path)
    }
}

impl From<GrayImage> for ImageData {
    fn from(image: GrayImage) -> Self {
        Self::Pixels(Arc::new(image))
    }
}
