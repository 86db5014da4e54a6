//! The names of held keyframes in a query: a set, small on the wire, refused where it is none.

use crate::common::*;
use proptest::collection::vec;
use proptest::prelude::*;
use protocol::*;
use std::collections::BTreeSet;

fn request_with(held: Vec<KeyframeId>) -> MatchRequest {
    MatchRequest { held, ..example(match_requests()) }
}

fn through(format: Format, request: &MatchRequest) -> Vec<KeyframeId> {
    decode::<MatchRequest>(format, &encode(format, request).unwrap()).unwrap().held
}

/// What a sender of gaps would send: the payload of a request with `list` in the place of its held keyframes.
fn payload_with(list: &[u8]) -> Vec<u8> {
    let empty = MatchRequest { map_version_held: None, max_keyframes: 1, ..request_with(Vec::new()) };
    let bytes = encode(Format::Bincode, &empty).unwrap();
    // Behind the list are the absent version and the number of keyframes, a byte each.
    let (before, behind) = bytes[16..].split_at(bytes.len() - 16 - 3);
    assert_eq!(behind, [0, 0, 1]);
    let payload = [before, list, &behind[1..]].concat();
    resealed(&payload, MatchRequest::TAG)
}

fn long(number: u64) -> Vec<u8> {
    [&[253][..], &number.to_le_bytes()].concat() // bincode's mark of an 8-byte integer
}

/// Names anywhere, at both ends of their range, and next to each other.
fn names_in_any_order() -> impl Strategy<Value = Vec<KeyframeId>> {
    let ends = prop_oneof![0..4_u64, (0..4_u64).prop_map(|below| u64::MAX - below)];
    vec(prop_oneof![any::<u64>(), ends, 9_000..9_040_u64], 0..60)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn held_keyframes_arrive_as_the_set_that_they_are(held in names_in_any_order()) {
        let set: Vec<KeyframeId> = held.iter().copied().collect::<BTreeSet<_>>().into_iter().collect();
        let request = request_with(held.clone());
        prop_assert_eq!(through(Format::Bincode, &request), set);
        prop_assert_eq!(through(Format::Json, &request), held);
    }

    #[test]
    fn the_same_set_is_the_same_bytes(mut held in names_in_any_order()) {
        let bytes = |held: &[KeyframeId]| encode(Format::Bincode, &request_with(held.to_vec())).unwrap();
        let first = bytes(&held);
        held.reverse();
        held.extend(held.clone());
        prop_assert_eq!(bytes(&held), first);
    }
}

#[test]
fn gaps_are_as_documented() {
    let bytes = payload_with(&[3, 7, 0, 3]);
    assert_eq!(decode::<MatchRequest>(Format::Bincode, &bytes).unwrap().held, [7, 8, 12]);
    let last = [&[2][..], &long(u64::MAX - 1), &[0]].concat();
    let held = decode::<MatchRequest>(Format::Bincode, &payload_with(&last)).unwrap().held;
    assert_eq!(held, [u64::MAX - 1, u64::MAX]);
}

#[test]
fn a_name_beyond_64_bits_is_refused() {
    let lists = [
        [&[2][..], &long(u64::MAX), &[0]].concat(),
        [&[2, 1][..], &long(u64::MAX)].concat(),
        [&[3][..], &long(1 << 63), &long((1 << 63) - 2), &[0]].concat(),
        [&[2][..], &long(u64::MAX), &long(u64::MAX)].concat(),
    ];
    for (k, list) in lists.iter().enumerate() {
        let error = decode::<MatchRequest>(Format::Bincode, &payload_with(list)).unwrap_err();
        assert!(matches!(error, CodecError::Malformed { .. }), "{k}: {error}");
        assert!(error.to_string().contains("exceeds 64 bits"), "{k}: {error}");
    }
}

#[test]
fn a_list_longer_than_the_payload_is_refused() {
    for claim in [1_u64 << 20, 1 << 40, u64::MAX] {
        let list = [&long(claim)[..], &[1, 2, 3]].concat();
        let error = decode::<MatchRequest>(Format::Bincode, &payload_with(&list)).unwrap_err();
        assert!(matches!(error, CodecError::Malformed { .. }), "{error}");
    }
}

/// A robot's default budget of keyframes, of a map with twice as many: their names are a small part of a query.
#[test]
fn the_names_of_5_000_held_keyframes_have_10_kb_at_most() {
    let with = |held: Vec<KeyframeId>| encode(Format::Bincode, &request_with(held)).unwrap().len();
    let none = with(Vec::new());
    let every_second = with((0..5_000).map(|k| 40_000 + 2 * k).collect()) - none;
    // Places of 50 keyframes each, thousands of names apart from each other.
    let places = with((0..5_000).rev().map(|k| 1_000_000 + k + k / 50 * 3_000).collect()) - none;
    for bytes in [every_second, places] {
        assert!((5_000..=10_000).contains(&bytes), "{bytes} bytes");
    }
}

/// Gaps of one byte each: a payload of 16 MB would name 16 million keyframes.
#[test]
fn a_list_beyond_its_limit_is_refused_before_it_is_read() {
    let (most, all) = (MAX_HELD_KEYFRAMES, 15_900_000_usize);
    let list = |length: usize| [&[252][..], &(length as u32).to_le_bytes(), &vec![0; length]].concat();
    let held = decode::<MatchRequest>(Format::Bincode, &payload_with(&list(most))).unwrap().held;
    assert_eq!(held.len(), most);
    for length in [most + 1, all] {
        let bytes = payload_with(&list(length));
        let begin = std::time::Instant::now();
        let error = decode::<MatchRequest>(Format::Bincode, &bytes).unwrap_err().to_string();
        assert!(error.contains("more than 20000"), "{error}");
        assert!(begin.elapsed() < std::time::Duration::from_secs(1), "{:?}", begin.elapsed());
    }
    let error = encode(Format::Bincode, &request_with((0..=most as u64).collect())).unwrap_err().to_string();
    assert!(error.contains("held") && error.contains("more than 20000"), "{error}");
    let request = serde_json::to_value(request_with(Vec::new())).unwrap();
    let with = |held: Vec<u64>, pixels: usize| {
        let mut request = request.clone();
        request["schema"] = SCHEMA_VERSION.into();
        request["held"] = held.into();
        request["features"]["pixels"] = vec![[1.0, 2.0]; pixels].into_iter().map(Vec::from).collect();
        decode::<MatchRequest>(Format::Json, request.to_string().as_bytes()).unwrap_err().to_string()
    };
    assert!(with(vec![7; most + 1], 0).contains("more than 20000"));
    assert!(with(Vec::new(), MAX_FEATURES + 1).contains("more than 20000"));
}
