//! Conversion of images, and images that cannot be used.

use super::*;
use crate::live::{LiveImageError, RawPixels};
use vision::{ImageError, RawImage};

const CALIBRATED: (u32, u32) = (8, 6);

fn gray() -> GrayImage {
    GrayImage::from_fn(SIZE.0, SIZE.1, |x, y| (30 * x + 5 * y) as u8)
}

fn raw(encoding: &str, padding: usize) -> RawPixels {
    let image = gray();
    let channels = RawImage::bytes_per_pixel(encoding).unwrap();
    let mut bytes = Vec::new();
    for y in 0..SIZE.1 {
        for pixel in image.row(y) {
            bytes.extend(std::iter::repeat_n(*pixel, channels));
        }
        bytes.extend(std::iter::repeat_n(99, padding));
    }
    let (width, height) = CALIBRATED;
    let step = (SIZE.0 * channels + padding) as u32;
    RawPixels { width, height, step, encoding: encoding.to_owned(), big_endian: false, bytes }
}

#[test]
fn every_encoding_of_grey_is_the_same_grey_image() {
    for encoding in ["mono8", "mono16", "rgb8", "bgra8"] {
        for padding in [0, 5] {
            let converted = LiveImage::Raw(raw(encoding, padding)).into_gray(CALIBRATED).unwrap();
            assert_eq!(converted, gray(), "{encoding} {padding}");
        }
    }
    assert_eq!(LiveImage::Encoded(gray().to_png().unwrap()).into_gray(CALIBRATED).unwrap(), gray());
}

#[test]
fn another_size_and_missing_bytes_are_named() {
    let wrong = LiveImage::Raw(raw("mono8", 0)).into_gray((752, 480)).unwrap_err();
    assert!(wrong.to_string().contains("8 x 6") && wrong.to_string().contains("752 x 480"), "{wrong}");
    for (step, bytes) in [(8, 47), (7, 48), (0, 47), (u32::MAX, 48), (8, 0)] {
        let raw = RawPixels { step, bytes: vec![0; bytes], ..raw("mono8", 0) };
        let error = LiveImage::Raw(raw).into_gray(CALIBRATED).unwrap_err();
        assert!(matches!(error, LiveImageError::Undecodable(ImageError::Raw { .. })), "{error}");
    }
}

#[test]
fn a_damaged_file_is_named() {
    let png = gray().to_png().unwrap();
    let half = LiveImage::Encoded(png[..png.len() - 20].to_vec()).into_gray(CALIBRATED).unwrap_err();
    assert!(matches!(half, LiveImageError::Undecodable(ImageError::Incomplete { .. })), "{half}");
    for bytes in [Vec::new(), vec![0; 100], b"\xff\xd8\xff\xe0 not a JPEG".to_vec()] {
        assert!(LiveImage::Encoded(bytes).into_gray(CALIBRATED).is_err());
    }
}
