//! 8-bit grey images; PNG and JPEG files.

use super::raw::is_12_bits;
use super::structure::{Structure, structure, without_metadata};
use std::io::Cursor;
use std::path::{Path, PathBuf};

/// Maximum width and height of a file, pixels: larger ones are refused before memory is allocated.
pub const MAX_IMAGE_SIDE: u32 = 16_384;

/// Most pixels of an encoded image: three times what the largest cameras of robots have. Decoding takes up to 9 bytes a pixel.
pub const MAX_PIXELS: u64 = 36_000_000;

/// Largest file of an image, bytes: four for each of [`MAX_PIXELS`], and metadata.
pub const MAX_IMAGE_FILE_BYTES: u64 = 4 * MAX_PIXELS + (16 << 20);

/// Most scans of a progressive JPEG image. Encoders write about ten; each costs a walk over the whole image.
pub const MAX_SCANS: usize = 64;

/// Memory that a decoder may take for each pixel, bytes: four channels of 16 bits, and as much again while they are converted.
const DECODER_BYTES_A_PIXEL: u64 = 16;
/// Memory that a decoder may take beside, bytes.
const DECODER_BYTES: u64 = 4 << 20;

/// An 8-bit grey image, row after row without gaps.
///
/// # Coordinate systems
/// x runs to the right, y down. Pixel `(0, 0)` is the top-left one; its centre has the coordinates `(0.0, 0.0)`.
///
/// # Example
/// ```
/// let image = vision::GrayImage::from_fn(4, 3, |x, y| (10 * y + x) as u8);
/// assert_eq!((image.width(), image.height()), (4, 3));
/// assert_eq!(image.row(2), &[20, 21, 22, 23]);
/// assert_eq!(image.get(3, 1), 13);
/// assert!(vision::GrayImage::new(4, 3, vec![0; 11]).is_err());
/// ```
#[derive(Clone, PartialEq, Eq)]
pub struct GrayImage {
    width: usize,
    height: usize,
    pixels: Vec<u8>,
}

/// Why an image could not be read, written or created.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImageError {
    /// The file cannot be read, or is not a PNG or JPEG image.
    #[error("{}: {source}; a PNG or JPEG image is needed", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: image::ImageError,
    },
    /// The file ends before its image does.
    #[error("{}: the image is cut off after {bytes} bytes; copy it again", path.display())]
    CutOff {
        /// The file.
        path: PathBuf,
        /// Its length.
        bytes: usize,
    },
    /// Bytes in memory are not a PNG or JPEG image.
    #[error("{0}; a PNG or JPEG image is needed")]
    Undecodable(#[source] image::ImageError),
    /// Bytes in memory end before their image does.
    #[error("the image is cut off after {bytes} bytes")]
    Incomplete {
        /// Their number.
        bytes: usize,
    },
    /// An encoded image has more pixels or more scans than are decoded.
    #[error(
        "the image has {} x {} pixels in {scans} scans; at most {MAX_PIXELS} pixels in {MAX_SCANS} scans are decoded", size.0, size.1
    )]
    TooCostly {
        /// Columns and rows.
        size: (u32, u32),
        /// Passes over the image.
        scans: usize,
    },
    /// The file cannot be written.
    #[error("{}: {source}", path.display())]
    Unwritable {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: image::ImageError,
    },
    /// The image cannot be encoded.
    #[error("the image cannot be encoded: {0}")]
    Encoding(#[source] image::ImageError),
    /// The pixels of an uncompressed image are in a format that is not known.
    #[error(
        "encoding \"{encoding}\" is not supported: use mono8, mono16, rgb8, bgr8, rgba8, bgra8, those with 16 bits, a \
         bayer pattern, yuv422, yuv422_yuy2, nv12 or nv21"
    )]
    Format {
        /// The format's name.
        encoding: String,
    },
    /// The two bytes of a pixel of YUV are in the other order.
    #[error(
        "what \"{encoding}\" calls luma hardly varies, but its colours do: the bytes are in the other order (yuyv, uyvy), and the driver \
         names the wrong encoding"
    )]
    ByteOrder {
        /// As it is named.
        encoding: String,
    },
    /// The data of an uncompressed image do not fit its size.
    #[error(
        "{bytes} bytes in rows of {step} are not an image of {} x {} pixels in {encoding}", size.0, size.1
    )]
    Raw {
        /// The format of the pixels.
        encoding: String,
        /// Columns and rows.
        size: (u32, u32),
        /// Bytes from one row to the next.
        step: u32,
        /// Bytes given.
        bytes: usize,
    },
    /// The image is part of a recording that cannot be read there.
    #[error("{name}: {source}")]
    Source {
        /// What was to be read.
        name: String,
        /// The cause.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// The number of bytes is not width times height, or zero.
    #[error("{bytes} bytes are not an image of {width} x {height} pixels")]
    Size {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Bytes given.
        bytes: usize,
    },
}

impl ImageError {
    /// Names the file whose bytes could not be decoded.
    #[must_use]
    pub fn of(self, path: &Path) -> Self {
        match self {
            Self::Incomplete { bytes } => Self::CutOff { path: path.to_path_buf(), bytes },
            Self::Undecodable(source) => Self::Unreadable { path: path.to_path_buf(), source },
            other @ Self::TooCostly { .. } => {
                Self::Source { name: path.display().to_string(), source: Box::new(other) }
            }
            other => other,
        }
    }
}

fn read_file(path: &Path) -> Result<Vec<u8>, ImageError> {
    files::read(path, MAX_IMAGE_FILE_BYTES).map_err(|error| ImageError::Undecodable(error.into()).of(path))
}

/// Bounds for the decoder of an image that was walked over.
fn decoder_limits(structure: Option<Structure>) -> Result<image::Limits, ImageError> {
    let (mut limits, found) = (image::Limits::default(), structure.unwrap_or_default());
    let (width, height) = found.size.unwrap_or((MAX_IMAGE_SIDE, MAX_IMAGE_SIDE));
    let pixels = found.size.map_or(MAX_PIXELS, |(width, height)| u64::from(width) * u64::from(height));
    if pixels > MAX_PIXELS || found.scans > MAX_SCANS {
        return Err(ImageError::TooCostly { size: (width, height), scans: found.scans });
    }
    (limits.max_image_width, limits.max_image_height) =
        (Some(width.min(MAX_IMAGE_SIDE)), Some(height.min(MAX_IMAGE_SIDE)));
    limits.max_alloc = Some(pixels * DECODER_BYTES_A_PIXEL + DECODER_BYTES);
    Ok(limits)
}

impl GrayImage {
    /// An image from its pixels, row after row.
    ///
    /// # Errors
    /// [`ImageError::Size`] unless there are `width * height` of them, and at least one.
    pub fn new(width: usize, height: usize, pixels: Vec<u8>) -> Result<Self, ImageError> {
        if pixels.is_empty() || width.checked_mul(height) != Some(pixels.len()) {
            return Err(ImageError::Size { width, height, bytes: pixels.len() });
        }
        Ok(Self { width, height, pixels })
    }

    /// An image from pixels whose number is known to be right.
    pub(crate) fn from_parts(width: usize, height: usize, pixels: Vec<u8>) -> Self {
        debug_assert_eq!(width * height, pixels.len());
        Self { width, height, pixels }
    }

    /// An image whose pixel in column `x` and row `y` is `value(x, y)`.
    pub fn from_fn(width: usize, height: usize, mut value: impl FnMut(usize, usize) -> u8) -> Self {
        let mut pixels = Vec::with_capacity(width * height);
        for y in 0..height {
            pixels.extend((0..width).map(|x| value(x, y)));
        }
        Self { width, height, pixels }
    }

    /// Reads a PNG or JPEG file; colours are converted to luma.
    ///
    /// # Errors
    /// As of [`GrayImage::decode`], with the name of the file; [`ImageError::Unreadable`] also where it is missing.
    pub fn read(path: &Path) -> Result<Self, ImageError> {
        let bytes = read_file(path)?;
        Self::decode(&bytes).map_err(|error| error.of(path))
    }

    /// Decodes a PNG or JPEG file in memory; colours are converted to luma, colour profiles ignored.
    ///
    /// What decoding may cost is checked before: the size and the scans by a walk over the file, the memory by the decoder.
    ///
    /// # Errors
    /// [`ImageError::Incomplete`]; [`ImageError::TooCostly`]: more than [`MAX_PIXELS`] or [`MAX_SCANS`];
    /// [`ImageError::Undecodable`]: damaged, not an image, or more than 16,384 columns or rows.
    pub fn decode(bytes: &[u8]) -> Result<Self, ImageError> {
        let structure = structure(bytes);
        if structure.is_some_and(|found| !found.is_complete) {
            return Err(ImageError::Incomplete { bytes: bytes.len() });
        }
        let limits = decoder_limits(structure)?;
        let pixels = without_metadata(bytes);
        let mut reader = image::ImageReader::new(Cursor::new(&*pixels))
            .with_guessed_format()
            .map_err(|error| ImageError::Undecodable(error.into()))?;
        reader.limits(limits);
        let mut decoded = reader.decode().map_err(ImageError::Undecodable)?;
        if let image::DynamicImage::ImageLuma16(wide) = &mut decoded
            && wide.iter().all(|pixel| is_12_bits(*pixel))
        {
            wide.iter_mut().for_each(|pixel| *pixel <<= 4);
        }
        let grey = decoded.into_luma8();
        let (width, height) = (grey.width() as usize, grey.height() as usize);
        Self::new(width, height, grey.into_raw())
    }

    /// Columns and rows of a PNG or JPEG file in memory, from its header.
    ///
    /// # Errors
    /// [`ImageError::Undecodable`].
    pub fn size_of_encoded(bytes: &[u8]) -> Result<(u32, u32), ImageError> {
        if let Some(size) = structure(bytes).and_then(|found| found.size) {
            return Ok(size);
        }
        image::ImageReader::new(Cursor::new(bytes))
            .with_guessed_format()
            .map_err(image::ImageError::from)
            .and_then(image::ImageReader::into_dimensions)
            .map_err(ImageError::Undecodable)
    }

    /// Columns and rows of a PNG or JPEG file, from its header.
    ///
    /// # Errors
    /// [`ImageError::Unreadable`].
    pub fn size_of_file(path: &Path) -> Result<(u32, u32), ImageError> {
        let bytes = read_file(path)?;
        Self::size_of_encoded(&bytes).map_err(|error| error.of(path))
    }

    /// Writes a PNG or JPEG file, chosen by the file name extension.
    ///
    /// # Errors
    /// [`ImageError::Unwritable`].
    pub fn write(&self, path: &Path) -> Result<(), ImageError> {
        let (width, height) = (self.width as u32, self.height as u32);
        image::save_buffer(path, &self.pixels, width, height, image::ExtendedColorType::L8)
            .map_err(|source| ImageError::Unwritable { path: path.to_path_buf(), source })
    }

    /// Encodes the image as a PNG file in memory.
    ///
    /// # Errors
    /// [`ImageError::Encoding`]: more columns or rows than PNG supports.
    pub fn to_png(&self) -> Result<Vec<u8>, ImageError> {
        let (width, height) = (self.width as u32, self.height as u32);
        let mut png = Cursor::new(Vec::new());
        let (colour, format) = (image::ExtendedColorType::L8, image::ImageFormat::Png);
        image::write_buffer_with_format(&mut png, &self.pixels, width, height, colour, format)
            .map_err(ImageError::Encoding)?;
        Ok(png.into_inner())
    }

    /// Encodes the image as a JPEG file in memory.
    ///
    /// # Arguments
    /// * `quality`: 1 (smallest file) to 100 (least loss).
    ///
    /// # Errors
    /// [`ImageError::Encoding`]: more than 65,535 columns or rows.
    pub fn to_jpeg(&self, quality: u8) -> Result<Vec<u8>, ImageError> {
        let (width, height) = (self.width as u32, self.height as u32);
        let mut jpeg = Vec::new();
        image::codecs::jpeg::JpegEncoder::new_with_quality(&mut jpeg, quality)
            .encode(&self.pixels, width, height, image::ExtendedColorType::L8)
            .map_err(ImageError::Encoding)?;
        Ok(jpeg)
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// All pixels, row after row.
    pub fn pixels(&self) -> &[u8] {
        &self.pixels
    }

    /// All pixels, to be changed.
    pub(super) fn pixels_mut(&mut self) -> &mut [u8] {
        &mut self.pixels
    }

    /// The pixels of row `y`.
    ///
    /// # Panics
    /// If `y >= height`.
    pub fn row(&self, y: usize) -> &[u8] {
        &self.pixels[y * self.width..(y + 1) * self.width]
    }

    /// The pixel in column `x` and row `y`.
    ///
    /// # Panics
    /// If the pixel lies outside the image.
    pub fn get(&self, x: usize, y: usize) -> u8 {
        self.row(y)[x]
    }
}

impl std::fmt::Debug for GrayImage {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "GrayImage({} x {})", self.width, self.height)
    }
}
