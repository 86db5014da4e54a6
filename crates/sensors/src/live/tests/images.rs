//! Conversion of images, and images that cannot be used.

use super::*;
use crate::live::{LiveImageError, PixelEncoding, RawImage};
use vision::ImageError;

const CALIBRATED: (u32, u32) = (8, 6);

fn gray() -> GrayImage {
    GrayImage::from_fn(SIZE.0, SIZE.1, |x, y| (30 * x + 5 * y) as u8)
}

fn raw(encoding: PixelEncoding, padding: usize) -> RawImage {
    let image = gray();
    let mut bytes = Vec::new();
    for y in 0..SIZE.1 {
        for pixel in image.row(y) {
            bytes.extend(std::iter::repeat_n(*pixel, encoding.bytes()));
        }
        bytes.extend(std::iter::repeat_n(99, padding));
    }
    let step = (SIZE.0 * encoding.bytes() + padding) as u32;
    RawImage { width: CALIBRATED.0, height: CALIBRATED.1, step, encoding, bytes }
}

#[test]
fn every_encoding_of_grey_is_the_same_grey_image() {
    let encodings = ["mono8", "rgb8", "bgr8"].map(|name| PixelEncoding::of_name(name).unwrap());
    for encoding in encodings {
        for padding in [0, 5] {
            let converted = LiveImage::Raw(raw(encoding, padding)).into_gray(CALIBRATED).unwrap();
            assert_eq!(converted, gray(), "{encoding:?} {padding}");
        }
    }
    assert_eq!(LiveImage::Encoded(gray().to_png().unwrap()).into_gray(CALIBRATED).unwrap(), gray());
    assert_eq!(PixelEncoding::of_name("yuv422"), None);
}

#[test]
fn colours_are_in_the_order_that_the_encoding_says() {
    let red = |encoding, bytes: [u8; 3]| {
        let raw = RawImage { width: 1, height: 1, step: 3, encoding, bytes: bytes.to_vec() };
        LiveImage::Raw(raw).into_gray((1, 1)).unwrap().get(0, 0)
    };
    assert_eq!(red(PixelEncoding::Rgb8, [255, 0, 0]), red(PixelEncoding::Bgr8, [0, 0, 255]));
    assert!(red(PixelEncoding::Rgb8, [255, 0, 0]) < red(PixelEncoding::Rgb8, [0, 255, 0]));
}

#[test]
fn another_size_and_missing_bytes_are_named() {
    let wrong = LiveImage::Raw(raw(PixelEncoding::Mono8, 0)).into_gray((752, 480)).unwrap_err();
    assert!(wrong.to_string().contains("8 x 6") && wrong.to_string().contains("752 x 480"), "{wrong}");
    for (step, bytes) in [(8, 47), (7, 48), (0, 48), (u32::MAX, 48), (8, 0)] {
        let raw = RawImage { step, bytes: vec![0; bytes], ..raw(PixelEncoding::Mono8, 0) };
        let error = LiveImage::Raw(raw).into_gray(CALIBRATED).unwrap_err();
        assert!(matches!(error, LiveImageError::Bytes { .. }), "{error}");
    }
}

#[test]
fn a_damaged_file_is_named() {
    let png = gray().to_png().unwrap();
    let half = LiveImage::Encoded(png[..png.len() - 20].to_vec()).into_gray(CALIBRATED).unwrap_err();
    assert!(matches!(half, LiveImageError::File(ImageError::Incomplete { .. })), "{half}");
    for bytes in [Vec::new(), vec![0; 100], b"\xff\xd8\xff\xe0 not a JPEG".to_vec()] {
        assert!(LiveImage::Encoded(bytes).into_gray(CALIBRATED).is_err());
    }
}
