//! Grey images, and reading them.

use std::path::{Path, PathBuf};

/// Larger images are refused before anything is allocated for them.
const MAX_SIDE: u32 = 16_384;

/// An 8-bit grey image, row after row without gaps.
///
/// Pixel `(0, 0)` is the top-left one, and the coordinates `(0.0, 0.0)` are its centre.
///
/// ```
/// let image = vision::GrayImage::from_fn(4, 3, |x, y| (10 * y + x) as u8);
/// assert_eq!((image.width(), image.height()), (4, 3));
/// assert_eq!(image.row(2), &[20, 21, 22, 23]);
/// ```
#[derive(Clone, PartialEq, Eq)]
pub struct GrayImage {
    width: usize,
    height: usize,
    pixels: Vec<u8>,
}

/// Why an image is not to be had.
#[derive(Debug, thiserror::Error)]
pub enum ImageError {
    /// The file cannot be read, or is no image of a kind that is understood.
    #[error("{}: {source}; a PNG or JPEG image is needed", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: image::ImageError,
    },
    /// The file cannot be written.
    #[error("{}: {source}", path.display())]
    Unwritable {
        /// The file.
        path: PathBuf,
        /// What went wrong.
        source: image::ImageError,
    },
    /// The image cannot be encoded.
    #[error("the image cannot be encoded: {0}")]
    Encoding(#[source] image::ImageError),
    /// The bytes do not fill the image.
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

impl GrayImage {
    /// An image of the given pixels, row after row.
    ///
    /// # Errors
    /// [`ImageError::Size`] unless there are `width * height` of them, and at least one.
    pub fn new(width: usize, height: usize, pixels: Vec<u8>) -> Result<Self, ImageError> {
        if pixels.is_empty() || width.checked_mul(height) != Some(pixels.len()) {
            return Err(ImageError::Size { width, height, bytes: pixels.len() });
        }
        Ok(Self { width, height, pixels })
    }

    /// An image of pixels that are known to fill it.
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

    /// Reads a PNG or JPEG file; colours become their brightness.
    ///
    /// # Errors
    /// [`ImageError::Unreadable`]: no such file, cut off, damaged, no image, or beyond 16,384 pixels a side.
    pub fn read(path: &Path) -> Result<Self, ImageError> {
        let unreadable = |source| ImageError::Unreadable { path: path.to_path_buf(), source };
        let mut reader = image::ImageReader::open(path)
            .and_then(image::ImageReader::with_guessed_format)
            .map_err(|error| unreadable(error.into()))?;
        let mut limits = image::Limits::default();
        limits.max_image_width = Some(MAX_SIDE);
        limits.max_image_height = Some(MAX_SIDE);
        reader.limits(limits);
        let grey = reader.decode().map_err(unreadable)?.into_luma8();
        let (width, height) = (grey.width() as usize, grey.height() as usize);
        Self::new(width, height, grey.into_raw())
    }

    /// Writes a PNG or JPEG file, as its ending says.
    ///
    /// # Errors
    /// [`ImageError::Unwritable`].
    pub fn write(&self, path: &Path) -> Result<(), ImageError> {
        let (width, height) = (self.width as u32, self.height as u32);
        image::save_buffer(path, &self.pixels, width, height, image::ExtendedColorType::L8)
            .map_err(|source| ImageError::Unwritable { path: path.to_path_buf(), source })
    }

    /// The image as the bytes of a PNG file.
    ///
    /// # Errors
    /// [`ImageError::Encoding`]: sides beyond what PNG can say.
    pub fn to_png(&self) -> Result<Vec<u8>, ImageError> {
        let (width, height) = (self.width as u32, self.height as u32);
        let mut png = std::io::Cursor::new(Vec::new());
        let (colour, format) = (image::ExtendedColorType::L8, image::ImageFormat::Png);
        image::write_buffer_with_format(&mut png, &self.pixels, width, height, colour, format)
            .map_err(ImageError::Encoding)?;
        Ok(png.into_inner())
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

    /// All pixels, row after row, to be changed.
    pub fn pixels_mut(&mut self) -> &mut [u8] {
        &mut self.pixels
    }

    /// The pixels of row `y`.
    ///
    /// # Panics
    /// Below the last row.
    pub fn row(&self, y: usize) -> &[u8] {
        &self.pixels[y * self.width..(y + 1) * self.width]
    }

    /// The pixel in column `x` and row `y`.
    ///
    /// # Panics
    /// Outside the image.
    pub fn get(&self, x: usize, y: usize) -> u8 {
        self.row(y)[x]
    }
}

impl std::fmt::Debug for GrayImage {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "GrayImage({} x {})", self.width, self.height)
    }
}
