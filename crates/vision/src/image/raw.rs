//! Uncompressed images as cameras and their drivers give them.

use super::gray::MAX_IMAGE_SIDE;
use super::{GrayImage, ImageError};

/// Colours that vary more than luma by this factor are not colours,
const MAX_COLOUR_VARIATION: u64 = 4;
/// where they vary by so much from pixel to pixel in the mean.
const MIN_VARIATION: u64 = 2;

/// An uncompressed image: rows of pixels, `step` bytes apart.
///
/// `encoding` is one of the names that ROS uses:
///
/// | encoding | grey value |
/// |---|---|
/// | `mono8`, `8UC1` | as it is |
/// | `rgb8`, `bgr8`, `rgba8`, `bgra8`, `8UC3`, `8UC4` | luma, as of PNG and JPEG files |
/// | `bayer_rggb8`, `bayer_bggr8`, `bayer_gbrg8`, `bayer_grbg8` | (R + 2 G + B) / 4 of the 3 x 3 pixels around |
/// | `yuv422` (`uyvy`), `yuv422_yuy2` (`yuyv`), `nv12`, `nv21`, `nv24` | luma |
/// | `mono16`, `rgb16`, `bayer_rggb16`, `16UC1` and their kin | the same of the upper bytes; where no channel of an image reaches 4,096, it has 12 bits: of a sixteenth |
///
/// Upper and lower case are the same.
///
/// # Example
/// ```
/// let data = [10, 20, 0, 30, 40, 0]; // two pixels a row, and a byte that belongs to none
/// let image = vision::RawImage { encoding: "mono8", width: 2, height: 2, step: 3, big_endian: false, data: &data };
/// assert_eq!(image.to_gray()?.pixels(), [10, 20, 30, 40]);
/// # Ok::<(), vision::ImageError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RawImage<'a> {
    /// Name of the pixels' format.
    pub encoding: &'a str,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Bytes from one row to the next; 0, which some drivers write, for rows without gaps.
    pub step: u32,
    /// Whether the upper byte of 16 bits comes first.
    pub big_endian: bool,
    /// The rows.
    pub data: &'a [u8],
}

/// How the channels of a row become grey values.
enum Pixels {
    /// The channel `offset` of every `stride`.
    Channel { offset: usize, stride: usize },
    /// Channels of red, green and blue in every `stride`.
    Colour { rgb: [usize; 3], stride: usize },
    /// One colour a pixel.
    Bayer,
}

/// The pixels of an encoding.
struct Layout {
    pixels: Pixels,
    /// Bytes of a channel.
    width: usize,
}

impl Layout {
    fn of(encoding: &str) -> Option<Self> {
        let encoding = encoding.to_ascii_lowercase();
        let narrow = encoding
            .strip_prefix("16uc")
            .map(|channels| format!("8uc{channels}"))
            .or_else(|| Some(format!("{}8", encoding.strip_suffix("16")?)));
        let width = if narrow.is_some() { 2 } else { 1 };
        let pixels = match narrow.unwrap_or(encoding).as_str() {
            // Luma is in a plane of its own, before the colours.
            "nv12" | "nv21" | "nv24" if width == 1 => Pixels::Channel { offset: 0, stride: 1 },
            "mono8" | "8uc1" => Pixels::Channel { offset: 0, stride: 1 },
            "yuv422" | "uyvy" if width == 1 => Pixels::Channel { offset: 1, stride: 2 },
            "yuv422_yuy2" | "yuyv" if width == 1 => Pixels::Channel { offset: 0, stride: 2 },
            "rgb8" => Pixels::Colour { rgb: [0, 1, 2], stride: 3 },
            "bgr8" | "8uc3" => Pixels::Colour { rgb: [2, 1, 0], stride: 3 },
            "rgba8" => Pixels::Colour { rgb: [0, 1, 2], stride: 4 },
            "bgra8" | "8uc4" => Pixels::Colour { rgb: [2, 1, 0], stride: 4 },
            "bayer_rggb8" | "bayer_bggr8" | "bayer_gbrg8" | "bayer_grbg8" => Pixels::Bayer,
            _ => return None,
        };
        Some(Self { pixels, width })
    }

    /// Channels of a pixel.
    fn stride(&self) -> usize {
        match self.pixels {
            Pixels::Channel { stride, .. } | Pixels::Colour { stride, .. } => stride,
            Pixels::Bayer => 1,
        }
    }

    /// Bytes of a pixel.
    fn bytes(&self) -> usize {
        self.stride() * self.width
    }
}

impl RawImage<'_> {
    /// Bytes of a pixel in an encoding; `None` where it is not in the table.
    pub fn bytes_per_pixel(encoding: &str) -> Option<usize> {
        Some(Layout::of(encoding)?.bytes())
    }

    /// Converts to grey.
    ///
    /// # Errors
    /// [`ImageError::Format`] for an encoding that is not in the table; [`ImageError::ByteOrder`] where the bytes of a YUV image are
    /// those of the other order; [`ImageError::Raw`] where the data are too short
    /// for the stated size, or the size is zero or above 16,384 columns or rows.
    pub fn to_gray(&self) -> Result<GrayImage, ImageError> {
        let layout = Layout::of(self.encoding)
            .ok_or_else(|| ImageError::Format { encoding: self.encoding.to_owned() })?;
        let (width, height) = (self.width as usize, self.height as usize);
        let is_allowed = |side: u32| (1..=MAX_IMAGE_SIDE).contains(&side);
        let row_bytes = width * layout.bytes();
        let step = if self.step == 0 { row_bytes } else { self.step as usize };
        let is_there = is_allowed(self.width)
            && is_allowed(self.height)
            && row_bytes <= step
            && step * (height - 1) + row_bytes <= self.data.len();
        if !is_there {
            return Err(ImageError::Raw {
                encoding: self.encoding.to_owned(),
                size: (self.width, self.height),
                step: self.step,
                bytes: self.data.len(),
            });
        }
        let rows = self.data.chunks(step).take(height).flat_map(|row| &row[..row_bytes]).copied();
        let channels: Vec<u8> = if layout.width == 1 {
            rows.collect()
        } else {
            upper_bits(&rows.collect::<Vec<u8>>(), self.big_endian)
        };
        let grey = match layout.pixels {
            Pixels::Channel { stride: 1, .. } => channels,
            Pixels::Channel { offset, stride } => {
                if is_luma_elsewhere(&channels, offset) {
                    return Err(ImageError::ByteOrder { encoding: self.encoding.to_owned() });
                }
                channels.into_iter().skip(offset).step_by(stride).collect()
            }
            Pixels::Colour { rgb, stride } => {
                let colour = |pixel: &[u8]| rgb.map(|at| pixel[at]);
                luma(self.width, self.height, channels.chunks_exact(stride).flat_map(colour).collect())
            }
            Pixels::Bayer => smooth_bayer(&channels, width, height),
        };
        GrayImage::new(width, height, grey)
    }
}

/// Whether every other byte, `offset` the first, varies so much less than those between that luma is in those: colours vary
/// less than luma in every scene.
fn is_luma_elsewhere(bytes: &[u8], offset: usize) -> bool {
    // The two colours alternate, so that each byte is compared with the next one of its kind.
    let variation = |offset: usize| -> u64 {
        let next = bytes.iter().skip(offset + 4).step_by(2);
        bytes.iter().skip(offset).step_by(2).zip(next).map(|(a, b)| u64::from(a.abs_diff(*b))).sum()
    };
    let (luma, colours) = (variation(offset), variation(1 - offset));
    colours > MIN_VARIATION * bytes.len() as u64 / 2 && colours > MAX_COLOUR_VARIATION * luma
}

/// The upper eight bits of channels of two bytes: of 16, or of 12 where none has more.
fn upper_bits(bytes: &[u8], big_endian: bool) -> Vec<u8> {
    let channel = |pair: &[u8]| {
        let pair = [pair[0], pair[1]];
        if big_endian { u16::from_be_bytes(pair) } else { u16::from_le_bytes(pair) }
    };
    let shift = if bytes.chunks_exact(2).all(|pair| is_12_bits(channel(pair))) { 4 } else { 8 };
    bytes.chunks_exact(2).map(|pair| (channel(pair) >> shift) as u8).collect()
}

/// Whether a channel may be one of 12 bits.
pub(super) fn is_12_bits(channel: u16) -> bool {
    channel < 1 << 12
}

/// Luma of red, green and blue bytes, with the weights that are used for files; empty where their number is wrong.
fn luma(width: u32, height: u32, rgb: Vec<u8>) -> Vec<u8> {
    let image = image::RgbImage::from_raw(width, height, rgb);
    image.map(|image| image::DynamicImage::from(image).into_luma8().into_raw()).unwrap_or_default()
}

/// Smooths with the weights 1-2-1 in both directions: in every 3 x 3 pixels of a Bayer pattern red and blue then weigh a
/// quarter each and green a half, wherever the pattern begins. At the borders it is mirrored, which keeps the pattern.
fn smooth_bayer(pixels: &[u8], width: usize, height: usize) -> Vec<u8> {
    let mirrored = |at: usize, size: usize| {
        let (before, after) =
            (at.checked_sub(1).unwrap_or(1), if at + 1 < size { at + 1 } else { at.saturating_sub(1) });
        [before.min(size - 1), at, at, after]
    };
    let mut grey = Vec::with_capacity(pixels.len());
    for y in 0..height {
        let rows = mirrored(y, height);
        for x in 0..width {
            let columns = mirrored(x, width);
            let sum: u32 = rows
                .iter()
                .flat_map(|row| columns.iter().map(move |column| u32::from(pixels[row * width + column])))
                .sum();
            grey.push(((sum + 8) / 16) as u8);
        }
    }
    grey
}

#[cfg(test)]
mod tests {
    use super::*;

    const COLOUR: [u8; 3] = [200, 100, 40];

    fn image<'a>(encoding: &'a str, bytes_per_pixel: u32, data: &'a [u8]) -> RawImage<'a> {
        RawImage { encoding, width: 6, height: 4, step: 6 * bytes_per_pixel, big_endian: false, data }
    }

    fn repeated(pixel: &[u8]) -> Vec<u8> {
        pixel.repeat(24)
    }

    #[test]
    fn every_order_of_colours_gives_the_same_luma_as_a_file() {
        let [red, green, blue] = COLOUR;
        let file = image::RgbImage::from_pixel(6, 4, image::Rgb(COLOUR));
        let expected = image::DynamicImage::from(file).into_luma8().into_raw();
        for (encoding, pixel) in [
            ("rgb8", &[red, green, blue][..]),
            ("bgr8", &[blue, green, red]),
            ("rgba8", &[red, green, blue, 7]),
            ("bgra8", &[blue, green, red, 7]),
        ] {
            let data = repeated(pixel);
            let grey = image(encoding, pixel.len() as u32, &data).to_gray().unwrap();
            assert_eq!(grey.pixels(), expected, "{encoding}");
        }
    }

    #[test]
    fn a_bayer_pattern_of_one_colour_is_grey_everywhere() {
        let [red, green, blue] = COLOUR.map(u32::from);
        let expected = ((red + 2 * green + blue + 2) / 4) as u8;
        for (encoding, pattern) in [
            ("bayer_rggb8", [0, 1, 1, 2]),
            ("bayer_bggr8", [2, 1, 1, 0]),
            ("bayer_gbrg8", [1, 2, 0, 1]),
            ("bayer_grbg8", [1, 0, 2, 1]),
        ] {
            let pixel = |at: usize| COLOUR[pattern[(at / 6 % 2) * 2 + at % 2]];
            let data: Vec<u8> = (0..24).map(pixel).collect();
            let grey = image(encoding, 1, &data).to_gray().unwrap();
            assert!(grey.pixels().iter().all(|&value| value == expected), "{encoding}: {:?}", grey.pixels());
        }
    }

    #[test]
    fn sixteen_bits_are_scaled_to_eight_in_both_byte_orders() {
        let little = repeated(&0xab_cd_u16.to_le_bytes());
        assert_eq!(image("mono16", 2, &little).to_gray().unwrap().get(5, 3), 0xab);
        let dark = repeated(&0x0a_bc_u16.to_le_bytes());
        assert_eq!(image("mono16", 2, &dark).to_gray().unwrap().get(5, 3), 0xab, "12 bits");
        let big = repeated(&0xab_cd_u16.to_be_bytes());
        let raw = RawImage { big_endian: true, ..image("mono16", 2, &big) };
        assert_eq!(raw.to_gray().unwrap().get(5, 3), 0xab);
    }

    #[test]
    fn sixteen_bits_a_colour_are_as_eight_and_names_in_upper_case_as_in_lower_case() {
        let wide = |pixel: &[u8]| pixel.iter().flat_map(|&byte| [99, byte]).collect::<Vec<u8>>();
        let [red, green, blue] = COLOUR;
        for (narrow, encoding, pixel) in [
            ("rgb8", "rgb16", &[red, green, blue][..]),
            ("bgr8", "bgr16", &[blue, green, red]),
            ("bgra8", "BGRA16", &[blue, green, red, 7]),
            ("bayer_rggb8", "bayer_rggb16", &[red]),
            ("mono8", "MONO8", &[red]),
        ] {
            let data = repeated(pixel);
            let expected = image(narrow, pixel.len() as u32, &data).to_gray().unwrap();
            let is_wide = encoding.ends_with("16");
            let data = if is_wide { repeated(&wide(pixel)) } else { data };
            let bytes_per_pixel = data.len() as u32 / 24;
            assert_eq!(image(encoding, bytes_per_pixel, &data).to_gray().unwrap(), expected, "{encoding}");
            // A step of zero is that of rows without gaps.
            let raw = RawImage { step: 0, ..image(encoding, bytes_per_pixel, &data) };
            assert_eq!(raw.to_gray().unwrap(), expected, "{encoding}");
        }
    }

    #[test]
    fn yuv_gives_its_luma() {
        let (uyvy, yuyv) = (repeated(&[1, 90]), repeated(&[90, 1]));
        assert_eq!(image("yuv422", 2, &uyvy).to_gray().unwrap().get(5, 3), 90);
        assert_eq!(image("yuv422_yuy2", 2, &yuyv).to_gray().unwrap().get(5, 3), 90);
        let planes = [vec![90; 24], vec![1; 12]].concat();
        assert_eq!(image("nv21", 1, &planes).to_gray().unwrap().pixels(), [90; 24]);
    }

    #[test]
    fn yuv_in_the_other_order_is_refused() {
        let bytes: Vec<u8> = (0..24).flat_map(|at| [(at * 37 % 251) as u8, 128]).collect();
        assert!(image("yuyv", 2, &bytes).to_gray().is_ok());
        let error = image("yuv422", 2, &bytes).to_gray().unwrap_err().to_string();
        assert!(error.contains("yuv422") && error.contains("order"), "{error}");
    }

    #[test]
    fn sizes_that_contradict_the_data_are_refused() {
        let data = [0; 24];
        let raw = image("mono8", 1, &data);
        assert!(raw.to_gray().is_ok());
        for wrong in [
            RawImage { width: 0, ..raw },
            RawImage { height: 0, ..raw },
            RawImage { height: 5, ..raw },
            RawImage { step: 5, ..raw },
            RawImage { step: u32::MAX, ..raw },
            RawImage { width: u32::MAX, height: u32::MAX, step: u32::MAX, ..raw },
            RawImage { encoding: "rgb8", ..raw },
        ] {
            assert!(matches!(wrong.to_gray(), Err(ImageError::Raw { .. })), "{wrong:?}");
        }
        let unknown = RawImage { encoding: "32FC1", ..raw };
        assert!(matches!(unknown.to_gray(), Err(ImageError::Format { .. })));
    }
}
