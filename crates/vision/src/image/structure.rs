//! The structure of an encoded image, from a walk over its chunks or segments: is it complete, how large is it, and what would
//! decoding it cost? Decoders fill what is missing with grey, and half an image is not an image.

use std::borrow::Cow;

/// What a walk over a PNG or JPEG file found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Structure {
    /// Columns and rows, where its header came.
    pub(super) size: Option<(u32, u32)>,
    /// Scans of a JPEG file: a progressive one has several, each over the whole image.
    pub(super) scans: usize,
    /// Whether its end was reached.
    pub(super) is_complete: bool,
    /// Whether there is more than pixels: profiles, texts, times, further frames.
    pub(super) has_metadata: bool,
}

/// Walks over a PNG or JPEG file; `None` for other formats.
///
/// PNG: the chunks are walked to `IEND`. JPEG: the segments are walked to the end marker `FFD9`, so that the end marker of
/// a preview inside does not count; what follows the image (a second preview, padding) does not matter.
pub(super) fn structure(bytes: &[u8]) -> Option<Structure> {
    let mut found = Structure::default();
    if bytes.starts_with(&PNG_SIGNATURE) {
        found.is_complete = walk_png(bytes, &mut found).is_some();
    } else if bytes.starts_with(&[MARKER, START_OF_IMAGE]) {
        found.is_complete = walk_jpeg(bytes, &mut found).is_some();
    } else {
        return None;
    }
    Some(found)
}

/// A PNG file without its metadata, which a decoder would unpack: a profile of a megabyte may have a gigabyte in it.
pub(super) fn without_metadata(bytes: &[u8]) -> Cow<'_, [u8]> {
    let is_png = bytes.starts_with(&PNG_SIGNATURE);
    if !is_png || !structure(bytes).is_some_and(|found| found.has_metadata) {
        return Cow::Borrowed(bytes);
    }
    let mut kept = PNG_SIGNATURE.to_vec();
    let mut at = PNG_SIGNATURE.len();
    while let Some((kind, next)) = png_chunk(bytes, at) {
        if PNG_PIXELS.contains(&kind) {
            kept.extend_from_slice(&bytes[at..next]);
        }
        at = next;
    }
    Cow::Owned(kept)
}

const PNG_SIGNATURE: [u8; 8] = *b"\x89PNG\r\n\x1a\n";
/// Kinds of chunks that make the pixels.
const PNG_PIXELS: [[u8; 4]; 5] = [*b"IHDR", *b"PLTE", *b"tRNS", *b"IDAT", *b"IEND"];
/// First byte of every marker of a JPEG file.
const MARKER: u8 = 0xff;
const START_OF_IMAGE: u8 = 0xd8;
const END_OF_IMAGE: u8 = 0xd9;
const START_OF_SCAN: u8 = 0xda;

/// Kind of the chunk at a position, and the position after it; `None` where it is not all there.
fn png_chunk(bytes: &[u8], at: usize) -> Option<([u8; 4], usize)> {
    let length = u32::from_be_bytes(bytes.get(at..at + 4)?.try_into().ok()?) as usize;
    let kind = bytes.get(at + 4..at + 8)?.try_into().ok()?;
    // Length, kind, data and checksum.
    let next = at.checked_add(12)?.checked_add(length)?;
    (next <= bytes.len()).then_some((kind, next))
}

fn walk_png(bytes: &[u8], found: &mut Structure) -> Option<()> {
    let mut at = PNG_SIGNATURE.len();
    loop {
        let (kind, next) = png_chunk(bytes, at)?;
        match &kind {
            b"IEND" => return Some(()),
            b"IHDR" => {
                let number =
                    |from: usize| Some(u32::from_be_bytes(bytes.get(from..from + 4)?.try_into().ok()?));
                found.size = Some((number(at + 8)?, number(at + 12)?));
            }
            other => found.has_metadata |= !PNG_PIXELS.contains(other),
        }
        at = next;
    }
}

fn walk_jpeg(bytes: &[u8], found: &mut Structure) -> Option<()> {
    let number = |at: usize| Some(u16::from_be_bytes(bytes.get(at..at + 2)?.try_into().ok()?));
    let mut at = 2;
    loop {
        // Between the segments any number of fill bytes may stand.
        if *bytes.get(at)? != MARKER {
            return None;
        }
        let kind = *bytes.get(at + 1)?;
        if is_start_of_frame(kind) {
            // Length, bits per sample, rows, columns.
            found.size = Some((number(at + 7)?.into(), number(at + 5)?.into()));
        }
        at += match kind {
            MARKER => 1,
            END_OF_IMAGE => return Some(()),
            // Markers without a segment.
            0x01 | 0xd0..=0xd8 => 2,
            _ => 2 + usize::from(number(at + 2)?),
        };
        if kind == START_OF_SCAN {
            found.scans += 1;
            at += scan_length(bytes.get(at..)?)?;
        }
    }
}

/// SOF0 to SOF15, without the tables (DHT, JPG, DAC) among them.
fn is_start_of_frame(kind: u8) -> bool {
    matches!(kind, 0xc0..=0xcf) && !matches!(kind, 0xc4 | 0xc8 | 0xcc)
}

/// Length of the compressed data of a scan: to the next marker that is neither an escaped byte nor a restart.
fn scan_length(data: &[u8]) -> Option<usize> {
    data.windows(2).position(|pair| pair[0] == MARKER && !matches!(pair[1], 0x00 | 0xd0..=0xd7 | MARKER))
}

#[cfg(test)]
mod tests {
    use super::{Structure, structure, without_metadata};
    use crate::{GrayImage, ImageError, MAX_PIXELS, MAX_SCANS};

    fn chunk(kind: [u8; 4], data: &[u8]) -> Vec<u8> {
        let sum = crc32(&[&kind, data].concat());
        [&(data.len() as u32).to_be_bytes()[..], &kind, data, &sum.to_be_bytes()].concat()
    }

    /// CRC-32 (IEEE), bit by bit.
    fn crc32(bytes: &[u8]) -> u32 {
        !bytes.iter().fold(u32::MAX, |sum, byte| {
            (0..8)
                .fold(sum ^ u32::from(*byte), |sum, _| (sum >> 1) ^ (0xedb8_8320 & (sum & 1).wrapping_neg()))
        })
    }

    fn png(width: usize, height: usize) -> Vec<u8> {
        GrayImage::from_fn(width, height, |x, y| (x * y + 7 * x) as u8).to_png().unwrap()
    }

    /// With chunks behind the header.
    fn with_chunks(png: &[u8], chunks: &[u8]) -> Vec<u8> {
        [&png[..33], chunks, &png[33..]].concat()
    }

    #[test]
    fn a_profile_is_not_unpacked() {
        let plain = png(64, 48);
        // Not a stream that can be unpacked: whoever looks at it fails.
        let profile = chunk(*b"iCCP", &[b"p\0\0".as_slice(), &vec![7; 100_000]].concat());
        let with_profile = with_chunks(&plain, &[profile, chunk(*b"tEXt", b"a\0b")].concat());
        assert_eq!(&*without_metadata(&with_profile), plain);
        assert_eq!(GrayImage::decode(&with_profile).unwrap(), GrayImage::decode(&plain).unwrap());
        assert_eq!(GrayImage::size_of_encoded(&with_profile).unwrap(), (64, 48));
        assert!(matches!(without_metadata(&plain), std::borrow::Cow::Borrowed(_)));
    }

    #[test]
    fn an_image_of_too_many_pixels_is_refused_by_its_header() {
        let mut large = png(64, 48);
        (large[18], large[22]) = (0x40, 0x40);
        assert_eq!(GrayImage::size_of_encoded(&large).unwrap(), (64 + (64 << 8), 48 + (64 << 8)));
        let error = GrayImage::decode(&large).unwrap_err();
        assert!(matches!(error, ImageError::TooCostly { .. }), "{error}");
        assert!(error.to_string().contains(&MAX_PIXELS.to_string()), "{error}");
    }

    #[test]
    fn a_progressive_image_of_thousands_of_scans_is_refused_before_it_is_decoded() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("image.jpg");
        GrayImage::from_fn(64, 48, |x, y| (x * y) as u8).write(&path).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let found = structure(&bytes).unwrap();
        assert_eq!(
            found,
            Structure { size: Some((64, 48)), scans: 1, is_complete: true, has_metadata: false }
        );
        let at = bytes.windows(2).position(|pair| pair == [0xff, 0xda]).unwrap();
        let (before, end) = (&bytes[..at], bytes.len() - 2);
        let repeated = [before, &bytes[at..end].repeat(4096), &bytes[end..]].concat();
        assert_eq!(structure(&repeated).unwrap().scans, 4096);
        let begin = std::time::Instant::now();
        let error = GrayImage::decode(&repeated).unwrap_err();
        assert!(matches!(error, ImageError::TooCostly { scans: 4096, .. }), "{error}");
        assert!(error.to_string().contains(&MAX_SCANS.to_string()), "{error}");
        assert!(begin.elapsed() < std::time::Duration::from_secs(1));
    }

    proptest::proptest! {
        /// Whatever the bytes are, the walk ends.
        #[test]
        fn the_walk_over_anything_ends(jpeg: bool, tail in proptest::collection::vec(proptest::num::u8::ANY, 0..400)) {
            let head: &[u8] = if jpeg { &[0xff, 0xd8] } else { b"\x89PNG\r\n\x1a\n" };
            let bytes = [head, &tail].concat();
            let found = structure(&bytes).unwrap();
            proptest::prop_assert!(found.scans <= bytes.len() / 2);
            let _ = GrayImage::size_of_encoded(&bytes);
        }
    }

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
