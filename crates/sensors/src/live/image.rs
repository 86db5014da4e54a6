//! Images as drivers send them, and their conversion to grey.

use vision::{GrayImage, ImageError};

/// An image as it arrives. It is decoded by the thread that reads the source, not by the one that brings it.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum LiveImage {
    /// A PNG or JPEG file.
    Encoded(Vec<u8>),
    /// Pixels, row after row.
    Raw(RawImage),
    /// Grey pixels.
    Gray(GrayImage),
}

/// Pixels as a driver gives them.
#[derive(Clone, Debug, PartialEq)]
pub struct RawImage {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Bytes from the begin of a row to that of the next.
    pub step: u32,
    /// What the bytes are.
    pub encoding: PixelEncoding,
    /// `height` times `step` of them; the last row may end with its last pixel.
    pub bytes: Vec<u8>,
}

/// Encoding of pixels, by the names of ROS.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum PixelEncoding {
    /// One byte a pixel.
    Mono8,
    /// Red, green, blue.
    Rgb8,
    /// Blue, green, red, as OpenCV has them.
    Bgr8,
}

impl PixelEncoding {
    /// The encoding of a name: `mono8`, `rgb8`, `bgr8`.
    pub fn of_name(name: &str) -> Option<Self> {
        match name {
            "mono8" => Some(Self::Mono8),
            "rgb8" => Some(Self::Rgb8),
            "bgr8" => Some(Self::Bgr8),
            _ => None,
        }
    }

    /// Bytes a pixel.
    pub fn bytes(self) -> usize {
        match self {
            Self::Mono8 => 1,
            Self::Rgb8 | Self::Bgr8 => 3,
        }
    }
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
    /// The number of bytes contradicts the size.
    #[error(
        "an image of {width} x {height} pixels has {bytes} bytes, {step} a row: at least {wanted} are needed"
    )]
    Bytes {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
        /// Bytes a row.
        step: u32,
        /// Bytes given.
        bytes: usize,
        /// Bytes that size and encoding need.
        wanted: usize,
    },
    /// The file is damaged.
    #[error("an image cannot be decoded: {0}")]
    File(#[from] ImageError),
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
            Self::Raw(raw) => raw.into_gray(),
            Self::Gray(image) => Ok(image),
        }
    }
}

impl RawImage {
    fn into_gray(self) -> Result<GrayImage, LiveImageError> {
        let Self { width, height, step, encoding, bytes } = self;
        let (columns, rows, stride) = (width as usize, height as usize, step as usize);
        let row_bytes = columns * encoding.bytes();
        let wanted = rows.saturating_sub(1).saturating_mul(stride).saturating_add(row_bytes);
        if stride < row_bytes || bytes.len() < wanted {
            let bytes = bytes.len();
            return Err(LiveImageError::Bytes {
                width,
                height,
                step,
                bytes,
                wanted: wanted.max(rows * row_bytes),
            });
        }
        if encoding == PixelEncoding::Mono8 && stride == columns {
            let mut pixels = bytes;
            pixels.truncate(wanted);
            return Ok(GrayImage::new(columns, rows, pixels)?);
        }
        let mut pixels = Vec::with_capacity(columns * rows);
        for row in bytes.chunks(stride).take(rows) {
            let row = &row[..row_bytes];
            match encoding {
                PixelEncoding::Mono8 => pixels.extend_from_slice(row),
                PixelEncoding::Rgb8 => pixels.extend(row.chunks_exact(3).map(|p| luma(p[0], p[1], p[2]))),
                PixelEncoding::Bgr8 => pixels.extend(row.chunks_exact(3).map(|p| luma(p[2], p[1], p[0]))),
            }
        }
        Ok(GrayImage::new(columns, rows, pixels)?)
    }
}

/// Luma of ITU-R BT.709, as colour files have it.
fn luma(red: u8, green: u8, blue: u8) -> u8 {
    ((2126 * u32::from(red) + 7152 * u32::from(green) + 722 * u32::from(blue)) / 10_000) as u8
}
