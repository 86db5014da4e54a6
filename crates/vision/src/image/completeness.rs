//! Whether the file of an image is complete. Decoders fill what is missing with grey, and half an image is not an image.

/// Whether a PNG or JPEG file ends before its image does; `false` for other formats.
///
/// PNG: the chunks are walked to `IEND`. JPEG: the segments are walked to the end marker `FFD9`, so that the end marker of
/// a preview inside does not count; what follows the image (a second preview, padding) does not matter.
pub(super) fn is_cut_off(bytes: &[u8]) -> bool {
    if bytes.starts_with(&PNG_SIGNATURE) {
        png_end(bytes).is_none()
    } else if bytes.starts_with(&[MARKER, START_OF_IMAGE]) {
        jpeg_end(bytes).is_none()
    } else {
        false
    }
}

const PNG_SIGNATURE: [u8; 8] = *b"\x89PNG\r\n\x1a\n";
/// First byte of every marker of a JPEG file.
const MARKER: u8 = 0xff;
const START_OF_IMAGE: u8 = 0xd8;
const END_OF_IMAGE: u8 = 0xd9;
const START_OF_SCAN: u8 = 0xda;

/// Position after the last chunk.
fn png_end(bytes: &[u8]) -> Option<usize> {
    let mut at = PNG_SIGNATURE.len();
    loop {
        let length = u32::from_be_bytes(bytes.get(at..at + 4)?.try_into().ok()?) as usize;
        let kind = bytes.get(at + 4..at + 8)?;
        // Length, kind, data and checksum.
        let next = at.checked_add(12)?.checked_add(length)?;
        if bytes.len() < next {
            return None;
        }
        if kind == b"IEND" {
            return Some(next);
        }
        at = next;
    }
}

/// Position after the end marker.
fn jpeg_end(bytes: &[u8]) -> Option<usize> {
    let mut at = 2;
    loop {
        // Between the segments any number of fill bytes may stand.
        if *bytes.get(at)? != MARKER {
            return None;
        }
        let kind = *bytes.get(at + 1)?;
        at += match kind {
            MARKER => 1,
            END_OF_IMAGE => return Some(at + 2),
            // Markers without a segment.
            0x01 | 0xd0..=0xd8 => 2,
            _ => 2 + usize::from(u16::from_be_bytes(bytes.get(at + 2..at + 4)?.try_into().ok()?)),
        };
        if kind == START_OF_SCAN {
            at += scan_length(bytes.get(at..)?)?;
        }
    }
}

/// Length of the compressed data of a scan: to the next marker that is neither an escaped byte nor a restart.
fn scan_length(data: &[u8]) -> Option<usize> {
    data.windows(2).position(|pair| pair[0] == MARKER && !matches!(pair[1], 0x00 | 0xd0..=0xd7 | MARKER))
}

#[cfg(test)]
mod tests {
    use crate::{GrayImage, ImageError};

    #[test]
    fn an_image_that_is_cut_off_anywhere_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let image = GrayImage::from_fn(64, 48, |x, y| (x * y + 7 * x) as u8);
        for name in ["image.png", "image.jpg"] {
            let path = folder.path().join(name);
            image.write(&path).unwrap();
            let bytes = std::fs::read(&path).unwrap();
            assert_eq!(GrayImage::read(&path).unwrap().width(), 64);
            for part in [0.3, 0.5, 0.9, 0.99] {
                std::fs::write(&path, &bytes[..(bytes.len() as f64 * part) as usize]).unwrap();
                let error = GrayImage::read(&path).unwrap_err();
                assert!(matches!(error, ImageError::CutOff { .. }), "{name} {part}: {error}");
                assert!(error.to_string().contains(name), "{error}");
            }
            std::fs::write(&path, &bytes[..bytes.len() - 1]).unwrap();
            assert!(GrayImage::read(&path).is_err(), "{name}");
            // Padding, or a preview behind the image.
            std::fs::write(&path, [&bytes[..], &[0; 5]].concat()).unwrap();
            assert!(GrayImage::read(&path).is_ok(), "{name}");
        }
    }

    #[test]
    fn the_end_of_a_preview_is_not_the_end_of_the_image() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("image.jpg");
        GrayImage::from_fn(64, 48, |x, y| (x * y) as u8).write(&path).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        // An application segment with a whole small image in it, as EXIF has, behind the start marker.
        let mut length = vec![0xff, 0xe1];
        length.extend((bytes.len() as u16 + 2).to_be_bytes());
        let with_preview = [&bytes[..2], &length, &bytes, &bytes[2..]].concat();
        std::fs::write(&path, &with_preview).unwrap();
        assert!(GrayImage::read(&path).is_ok());
        std::fs::write(&path, &with_preview[..with_preview.len() - bytes.len() / 2]).unwrap();
        assert!(matches!(GrayImage::read(&path), Err(ImageError::CutOff { .. })));
    }
}
