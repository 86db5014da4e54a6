//! Laws of segments: what is written is read back, the same contents have the same bytes, and no damage passes.

use std::sync::LazyLock;

use map::MapContents;
use map::file::record::Element;
use map::file::{Segment, SegmentError, SegmentName, SegmentWriter};
use proptest::prelude::*;
use testing::{Place, PlaceOptions, add_aliases, add_common_errors, add_existence};

fn place(common: bool, aliases: bool) -> MapContents {
    let options = PlaceOptions { keyframes: 6, landmarks: 80, ..PlaceOptions::default() };
    let mut map = Place::new(&options).map;
    if common {
        add_common_errors(&mut map, 2);
    }
    if aliases {
        add_aliases(&mut map);
    }
    map.sort();
    map
}

fn encoded(segment: &Segment) -> Vec<u8> {
    fn add<E: Element>(writer: &mut SegmentWriter, elements: &[E]) {
        for element in elements {
            writer.add(element).unwrap();
        }
    }
    let mut writer = SegmentWriter::default();
    // The order of the lists in a segment does not depend on that in which they were written.
    add(&mut writer, &segment.existence);
    add(&mut writer, &segment.aliases);
    add(&mut writer, &segment.landmarks);
    add(&mut writer, &segment.keyframes);
    add(&mut writer, &segment.common_errors);
    add(&mut writer, &segment.cross_covariances);
    writer.finish()
}

fn segment(map: MapContents) -> Segment {
    let MapContents { keyframes, landmarks, cross_covariances, common_errors, aliases, existence, .. } = map;
    Segment { keyframes, landmarks, cross_covariances, common_errors, aliases, existence }
}

/// By whether they have common errors, and aliases.
static SEGMENTS: LazyLock<[[Vec<u8>; 2]; 2]> = LazyLock::new(|| {
    [false, true].map(|common| [false, true].map(|aliases| encoded(&segment(place(common, aliases)))))
});

#[test]
fn what_is_written_is_read_back_and_written_again_the_same() {
    for (common, aliases) in [(false, false), (false, true), (true, false), (true, true)] {
        let bytes = &SEGMENTS[usize::from(common)][usize::from(aliases)];
        let read = Segment::decode(bytes).unwrap();
        assert_eq!(read, segment(place(common, aliases)));
        assert_eq!(SegmentName::of(&encoded(&read)), SegmentName::of(bytes));
    }
    assert_eq!(Segment::decode(&SegmentWriter::default().finish()).unwrap(), Segment::default());
}

#[test]
fn the_last_list_is_written_where_there_is_something_in_it() {
    let mut map = place(false, true);
    let without = encoded(&segment(map.clone()));
    assert!(without.starts_with(b"driftless segment 4\n"));
    add_existence(&mut map);
    let with = encoded(&segment(map.clone()));
    assert!(with.starts_with(b"driftless segment 5\n"));
    assert_eq!(Segment::decode(&with).unwrap(), segment(map));
    // Neither is taken for the other.
    let [mut as_5, mut as_4] = [without, with];
    as_5[b"driftless segment ".len()] = b'5';
    as_4[b"driftless segment ".len()] = b'4';
    assert!(matches!(Segment::decode(&as_5), Err(SegmentError::CutOff { .. })));
    assert!(matches!(Segment::decode(&as_4), Err(SegmentError::TooLong { .. })));
}

#[test]
fn records_that_do_not_ascend_are_refused() {
    let mut other = segment(place(true, true));
    other.landmarks.swap(3, 4);
    assert!(matches!(Segment::decode(&encoded(&other)), Err(SegmentError::Order { .. })));
    let mut twice = segment(place(true, true));
    twice.cross_covariances.push(twice.cross_covariances.last().unwrap().clone());
    assert!(matches!(Segment::decode(&encoded(&twice)), Err(SegmentError::Order { .. })));
}

proptest! {
    #[test]
    fn no_bytes_make_it_panic_and_none_are_believed(
        common: bool, aliases: bool,
        cut in 0..1_000_000_usize, at in 0..1_000_000_usize, bit in 0..8_u8, noise: Vec<u8>,
    ) {
        let bytes = SEGMENTS[usize::from(common)][usize::from(aliases)].as_slice();
        prop_assert!(Segment::decode(&bytes[..cut % bytes.len()]).is_err());
        let mut flipped = bytes.to_vec();
        flipped[at % bytes.len()] ^= 1 << bit;
        prop_assert!(Segment::decode(&flipped).is_err());
        prop_assert!(Segment::decode(&[&b"driftless segment 4\n"[..], &noise].concat()).is_err());
        prop_assert!(Segment::decode(&[bytes, &[0]].concat()).is_err());
    }
}
