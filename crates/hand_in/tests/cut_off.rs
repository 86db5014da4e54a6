//! Files that were cut off, damaged or made up.

use crate::example_session::{block, write};
use hand_in::{HandInError, Session};
use proptest::prelude::*;
use std::path::Path;

fn read(bytes: &[u8]) -> Result<Session, HandInError> {
    Session::of_bytes(Path::new("a.session"), bytes)
}

fn written(seconds: i64) -> (Vec<u8>, Vec<u64>) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.session");
    let ends = write(&path, seconds);
    (std::fs::read(&path).unwrap(), ends)
}

/// Bytes before and behind the end of a block that are all tried.
const NEAR_AN_END: u64 = 32;

#[test]
fn what_was_written_as_a_whole_counts_wherever_the_robot_is_stopped() {
    counts_what_is_whole(29);
}

#[test]
#[ignore = "every byte, a minute"]
fn what_was_written_as_a_whole_counts_at_every_byte() {
    counts_what_is_whole(1);
}

/// Cuts off at every `step`-th byte, and at all about the ends of the blocks.
fn counts_what_is_whole(step: usize) {
    let (bytes, ends) = written(3);
    let is_near_an_end = |length: usize| ends.iter().any(|end| end.abs_diff(length as u64) <= NEAR_AN_END);
    for length in (0..=bytes.len()).filter(|&length| length % step == 0 || is_near_an_end(length)) {
        let whole = ends.iter().filter(|end| **end <= length as u64).count();
        match read(&bytes[..length]) {
            Ok(session) => {
                let chunks = whole.saturating_sub(1).min(3);
                assert_eq!(session.frames.len(), 5 * chunks, "{length} bytes");
                assert_eq!(session.readings.len(), 200 * chunks);
                assert_eq!(session.recorded.map(|recorded| recorded.id[0]), (chunks as u8).checked_sub(1));
                assert_eq!(session.whole_bytes, ends[whole - 1]);
                assert_eq!(session.is_ended, length == bytes.len());
            }
            Err(HandInError::NoHeader { .. } | HandInError::OtherFormat { .. }) => assert_eq!(whole, 0),
            Err(error) => panic!("{length} bytes: {error}"),
        }
    }
}

#[test]
fn another_format_and_another_schema_are_named() {
    let (mut bytes, _) = written(1);
    assert!(matches!(read(b"timestamp,x\n"), Err(HandInError::OtherFormat { .. })));
    bytes[8] = 9;
    let error = read(&bytes).unwrap_err().to_string();
    assert!(error.contains("schema 9") && error.contains("update"), "{error}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn a_damaged_byte_costs_what_follows_it_and_no_more(at in 0..30_000_usize, bits in 1..=255_u8) {
        let (mut bytes, ends) = written(2);
        let at = at % bytes.len();
        bytes[at] ^= bits;
        let whole = ends.iter().filter(|end| **end <= at as u64).count();
        let read = read(&bytes).map(|session| session.frames.len()).ok();
        prop_assert_eq!(read, whole.checked_sub(1).map(|chunks| 5 * chunks.min(2)));
    }

    /// Checksums keep damage out, not malice.
    #[test]
    fn blocks_of_any_content_are_refused_or_read(payload in prop::collection::vec(any::<u8>(), 0..400), kind in 0..6_u8) {
        let (bytes, ends) = written(1);
        let mut bytes = bytes[..ends[1] as usize].to_vec();
        bytes.extend(block(kind, &payload));
        if let Ok(session) = read(&bytes) {
            prop_assert!(session.frames.windows(2).all(|frames| frames[0].stamp_ns < frames[1].stamp_ns));
            prop_assert!(session.readings.windows(2).all(|readings| readings[0].stamp_ns < readings[1].stamp_ns));
        }
    }

    #[test]
    fn chunks_of_any_content_are_refused_or_read(
        damage in prop::collection::vec((0..30_000_usize, any::<u8>()), 1..6)
    ) {
        let (bytes, ends) = written(1);
        let (header, chunk) = bytes[..ends[1] as usize].split_at(ends[0] as usize);
        let mut payload = chunk[9..].to_vec();
        for (at, byte) in damage {
            let at = at % payload.len();
            payload[at] = byte;
        }
        let bytes = [header, &block(2, &payload)].concat();
        if let Ok(session) = read(&bytes) {
            prop_assert!(session.readings.iter().all(types::ImuSample::is_finite));
            prop_assert!(session.readings.windows(2).all(|readings| readings[0].stamp_ns < readings[1].stamp_ns));
        }
    }
}
