//! Damaged and hostile bytes are refused, whatever they claim, and cost nothing.

use crate::common::*;
use proptest::prelude::*;
use protocol::*;

const HEADER: usize = 16;

/// A request with something in every field, small enough to be damaged in every way.
fn small_request() -> MatchRequest {
    MatchRequest {
        features: FeatureSet {
            pixels: vec![[1.0, 2.0], [3.0, 4.0]],
            descriptors: Descriptors { kind: DescriptorKind::Binary, width: 4, bytes: (0..8).collect() },
            extractor: "sift-1".to_owned(),
        },
        prior: Some(PosePrior { global_from_camera: example(poses()) }),
        held: vec![5, 6, 7],
        ..example(match_requests())
    }
}

fn refusal<M: Message + std::fmt::Debug>(format: Format, bytes: &[u8]) -> CodecError {
    decode::<M>(format, bytes).unwrap_err()
}

/// Most virtual memory that this process ever had, KiB (Linux; elsewhere 0 and the check is void).
fn peak_memory() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmPeak:"));
    line.and_then(|line| line.trim().trim_end_matches(" kB").parse().ok()).unwrap_or(0)
}

fn assert_costs_no_memory(work: impl FnOnce()) {
    let before = peak_memory();
    work();
    let grown = peak_memory() - before;
    // Test threads of other tests reserve 64 MiB arenas each; a believed length here is 1 TiB or more.
    assert!(grown < 2 << 20, "{grown} KiB were reserved for lengths that lie");
}

#[test]
fn the_envelope_is_as_documented() {
    let bytes = encode(Format::Bincode, &small_request()).unwrap();
    assert_eq!(resealed(&bytes[HEADER..], MatchRequest::TAG), bytes);
}

#[test]
fn every_flipped_bit_is_refused() {
    let mut bytes = encode(Format::Bincode, &small_request()).unwrap();
    for bit in 0..8 * bytes.len() {
        bytes[bit / 8] ^= 1 << (bit % 8);
        assert!(decode::<MatchRequest>(Format::Bincode, &bytes).is_err(), "bit {bit} flipped and accepted");
        bytes[bit / 8] ^= 1 << (bit % 8);
    }
    decode::<MatchRequest>(Format::Bincode, &bytes).unwrap();
}

/// JSON has no checksum: a flip may be accepted, but only as a message that makes sense.
#[test]
fn a_flipped_bit_in_json_is_refused_or_makes_sense() {
    let mut bytes = encode(Format::Json, &small_request()).unwrap();
    for bit in 0..8 * bytes.len() {
        bytes[bit / 8] ^= 1 << (bit % 8);
        if let Ok(message) = decode::<MatchRequest>(Format::Json, &bytes) {
            message.validate().unwrap();
        }
        bytes[bit / 8] ^= 1 << (bit % 8);
    }
}

#[test]
fn every_truncation_and_every_addition_is_refused() {
    for format in Format::ALL {
        let bytes = encode(format, &small_request()).unwrap();
        for length in 0..bytes.len() {
            let error = refusal::<MatchRequest>(format, &bytes[..length]);
            if format == Format::Bincode {
                let expected = if length < HEADER { "truncated" } else { "was cut" };
                assert!(error.to_string().contains(expected), "{error}");
            }
        }
        let longer = [&bytes[..], b"7"].concat();
        decode::<MatchRequest>(format, &longer).unwrap_err();
    }
}

/// The same with a correct envelope: the payload itself is too short or too long.
#[test]
fn a_payload_that_ends_early_or_late_is_refused_under_a_correct_envelope() {
    let bytes = encode(Format::Bincode, &small_request()).unwrap();
    let payload = &bytes[HEADER..];
    for length in 0..payload.len() {
        let error =
            refusal::<MatchRequest>(Format::Bincode, &resealed(&payload[..length], MatchRequest::TAG));
        assert!(matches!(error, CodecError::Malformed { .. }), "{error}");
    }
    let longer = [payload, &[0]].concat();
    let error = refusal::<MatchRequest>(Format::Bincode, &resealed(&longer, MatchRequest::TAG));
    assert!(matches!(error, CodecError::Malformed { .. }), "{error}");
}

/// Wherever a length may be: claim 1 TiB, 2^63 and 2^64 - 1 elements there.
#[test]
fn a_hostile_length_never_allocates() {
    let bytes = encode(Format::Bincode, &small_request()).unwrap();
    let payload = &bytes[HEADER..];
    assert_costs_no_memory(|| {
        for claim in [1_u64 << 40, 1 << 63, u64::MAX] {
            let length = [&[253][..], &claim.to_le_bytes()].concat(); // bincode's mark of an 8-byte integer
            for offset in 0..payload.len() {
                for rest in [offset + 1, (offset + length.len()).min(payload.len())] {
                    let hostile = [&payload[..offset], &length, &payload[rest..]].concat();
                    let _ = decode::<MatchRequest>(Format::Bincode, &resealed(&hostile, MatchRequest::TAG));
                }
            }
        }
    });
    // The first field is the robot's name: there it certainly is a length.
    let hostile = [&[253][..], &u64::MAX.to_le_bytes(), b"robot"].concat();
    let error = refusal::<MatchRequest>(Format::Bincode, &resealed(&hostile, MatchRequest::TAG));
    assert!(matches!(error, CodecError::Malformed { .. }), "{error}");
}

#[test]
fn the_envelope_s_length_is_not_believed() {
    let mut bytes = encode(Format::Bincode, &small_request()).unwrap();
    for claim in [0, u32::MAX] {
        bytes[8..12].copy_from_slice(&claim.to_le_bytes());
        let error = refusal::<MatchRequest>(Format::Bincode, &bytes);
        assert!(matches!(error, CodecError::WrongLength { .. }), "{error}");
    }
}

#[test]
fn a_payload_beyond_the_limit_is_refused_unread() {
    let bytes = vec![b' '; MAX_MESSAGE_BYTES + 1];
    for format in Format::ALL {
        assert!(matches!(refusal::<MatchRequest>(format, &bytes), CodecError::TooLong { .. }));
    }
}

#[test]
fn a_message_beyond_the_limit_is_not_sent() {
    let mut change = example(map_changes());
    change.changed = vec![u64::MAX; MAX_MESSAGE_BYTES / 9];
    for format in Format::ALL {
        assert!(matches!(encode(format, &change), Err(CodecError::TooLong { .. })));
    }
}

/// Widths and counts written in JSON reserve nothing; deep nesting does not overflow the stack.
#[test]
fn hostile_json_is_refused_and_costs_nothing() {
    let nested = format!("{{\"schema\":10,\"held\":{}", "[".repeat(1_000_000));
    let unknown = format!("{{\"schema\":10,\"unknown\":{}", "[".repeat(1_000_000));
    let features = r#"{"pixels": [], "descriptors": {"kind": "binary", "width": 65535, "hex": ["00"]}}"#;
    let wide = format!("{{\"schema\":10,\"features\":{features}}}");
    let huge = r#"{"schema":10,"max_keyframes":1e999}"#.to_owned();
    assert_costs_no_memory(|| {
        for text in
            [nested, unknown, wide, huge, "[1]".into(), "null".into(), String::new(), "\"\u{0}".into()]
        {
            decode::<MatchRequest>(Format::Json, text.as_bytes()).unwrap_err();
        }
    });
}

#[test]
fn hexadecimal_that_is_none_is_refused() {
    let descriptors = |hex: &str| {
        let text = format!("{{\"kind\":\"binary\",\"width\":2,\"hex\":[\"{hex}\"]}}");
        serde_json::from_str::<Descriptors>(&text)
    };
    assert_eq!(descriptors("09aF").unwrap().bytes, [0x09, 0xaf]);
    for wrong in ["", "09a", "09aF0", "09ag", "é0a", "+9af"] {
        descriptors(wrong).unwrap_err();
    }
}

#[test]
fn another_schema_says_both_versions_and_what_to_do() {
    let text = String::from_utf8(encode(Format::Json, &small_request()).unwrap()).unwrap();
    for other in [OLDEST_SCHEMA - 1, SCHEMA_VERSION + 2] {
        let payload = encode(Format::Bincode, &small_request()).unwrap();
        let bytes = sealed_as(other, &payload[HEADER..], MatchRequest::TAG);
        let json = text.replacen("\"schema\":10", &format!("\"schema\":{other}"), 1);
        for (format, bytes) in [(Format::Bincode, &bytes[..]), (Format::Json, json.as_bytes())] {
            let error = refusal::<MatchRequest>(format, bytes);
            let CodecError::SchemaMismatch { found, expected: SCHEMA_VERSION } = error else {
                panic!("{error}");
            };
            assert_eq!(found, u64::from(other));
            let said = error.to_string();
            let schemas = [format!("schema {other}"), "schema 10".to_owned(), "update".to_owned()];
            assert!(schemas.iter().all(|part| said.contains(part)), "{said}");
            assert_eq!(ErrorReply::from(&error).code, ErrorCode::SchemaMismatch);
        }
    }
    let missing = text.replacen("\"schema\":10,", "", 1);
    let error = refusal::<MatchRequest>(Format::Json, missing.as_bytes());
    assert!(matches!(error, CodecError::MissingSchema));
}

#[test]
fn the_next_schema_is_read_but_for_what_it_appends() {
    let request = small_request();
    let sealed = |payload: &[u8]| sealed_as(SCHEMA_VERSION + 1, payload, MatchRequest::TAG);
    let payload = &encode(Format::Bincode, &request).unwrap()[HEADER..];
    for appended in [&[][..], &[1, 2, 3]] {
        let bytes = sealed(&[payload, appended].concat());
        assert_eq!(decode::<MatchRequest>(Format::Bincode, &bytes).unwrap(), request);
    }
    let text = String::from_utf8(encode(Format::Json, &request).unwrap()).unwrap();
    let next = text.replacen("\"schema\":10,", "\"schema\":11,\"floor\":3,", 1);
    assert_eq!(decode::<MatchRequest>(Format::Json, next.as_bytes()).unwrap(), request);
    // What cannot be read at all is another schema, and no damage.
    let cut = sealed(&payload[..payload.len() / 2]);
    assert!(matches!(
        refusal::<MatchRequest>(Format::Bincode, &cut),
        CodecError::SchemaMismatch { found: 11, .. }
    ));
}

/// Schema 10 appended the kinds of features to the info of a map.
#[test]
fn the_schema_before_is_read_without_what_it_did_not_have() {
    let info = example(map_infos());
    let without = MapInfoReply { feature_kinds: Vec::new(), ..info };
    let payload = &encode(Format::Bincode, &without).unwrap()[HEADER..];
    let former = sealed_as(SCHEMA_VERSION - 1, &payload[..payload.len() - 1], MapInfoReply::TAG);
    assert_eq!(decode::<MapInfoReply>(Format::Bincode, &former).unwrap(), without);
    let text = String::from_utf8(encode(Format::Json, &without).unwrap()).unwrap();
    let former = text.replacen("\"schema\":10", "\"schema\":9", 1).replacen(",\"feature_kinds\":[]", "", 1);
    assert!(former.len() + 18 < text.len());
    assert_eq!(decode::<MapInfoReply>(Format::Json, former.as_bytes()).unwrap(), without);
}

#[test]
fn another_magic_is_refused() {
    let json = encode(Format::Json, &small_request()).unwrap();
    assert!(matches!(refusal::<MatchRequest>(Format::Bincode, &json), CodecError::WrongMagic));
    let bincode = encode(Format::Bincode, &small_request()).unwrap();
    assert!(matches!(refusal::<MatchRequest>(Format::Json, &bincode), CodecError::Malformed { .. }));
}

#[test]
fn another_message_is_refused_by_name() {
    for format in Format::ALL {
        let bytes = encode(format, &example(robot_poses())).unwrap();
        let error = refusal::<MatchRequest>(format, &bytes);
        assert!(matches!(error, CodecError::WrongType { .. }), "{error}");
        assert!(error.to_string().contains("expected a match_request"), "{error}");
    }
}

proptest! {
    #[test]
    fn random_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        for tag in [MatchRequest::TAG, MatchReply::TAG] {
            let sealed = resealed(&bytes, tag);
            for payload in [&bytes, &sealed] {
                let _ = decode::<MatchRequest>(Format::Bincode, payload);
                let _ = decode::<MatchReply>(Format::Bincode, payload);
                let _ = decode::<MatchRequest>(Format::Json, payload);
            }
        }
    }

    /// Under a correct checksum, a changed byte is refused or gives a message that makes sense.
    #[test]
    fn a_forged_byte_is_refused_or_makes_sense(reply in match_replies(), offset: prop::sample::Index, byte: u8) {
        let bytes = encode(Format::Bincode, &reply).unwrap();
        let mut payload = bytes[HEADER..].to_vec();
        let position = offset.index(payload.len());
        payload[position] = byte;
        if let Ok(message) = decode::<MatchReply>(Format::Bincode, &resealed(&payload, MatchReply::TAG)) {
            message.validate().unwrap();
        }
    }
}
