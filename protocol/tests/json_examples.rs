//! The JSON examples in `examples/json` are valid messages, and there is one for every message type.

use protocol::*;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// The files of a folder of this crate, by name without extension.
fn files(folder: &str) -> BTreeMap<String, PathBuf> {
    let entries = std::fs::read_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join(folder)).unwrap();
    let paths = entries.map(|entry| entry.unwrap().path());
    paths.map(|path| (path.file_stem().unwrap().to_str().unwrap().to_owned(), path)).collect()
}

/// Decodes and encodes again; every field of the message must be in the file.
fn assert_round_trip<M: Message>(text: &[u8]) {
    let message: M = decode(Format::Json, text).unwrap();
    let again: Value = serde_json::from_slice(&encode(Format::Json, &message).unwrap()).unwrap();
    assert_eq!(again, serde_json::from_slice::<Value>(text).unwrap());
    let bytes = encode(Format::Bincode, &message).unwrap();
    decode::<M>(Format::Bincode, &bytes).unwrap();
}

fn type_of(text: &[u8]) -> String {
    let value: Value = serde_json::from_slice(text).unwrap();
    value["type"].as_str().unwrap().to_owned()
}

#[test]
fn every_example_is_a_valid_message() {
    for (name, path) in files("examples/json") {
        let text = std::fs::read(path).unwrap();
        let kind = type_of(&text);
        assert!(name.starts_with(&kind), "{name} is a {kind}");
        match kind.as_str() {
            MatchRequest::NAME => assert_round_trip::<MatchRequest>(&text),
            MatchReply::NAME => assert_round_trip::<MatchReply>(&text),
            LocalizeRequest::NAME => assert_round_trip::<LocalizeRequest>(&text),
            LocalizeReply::NAME => assert_round_trip::<LocalizeReply>(&text),
            MapInfoReply::NAME => assert_round_trip::<MapInfoReply>(&text),
            KeyframeReply::NAME => assert_round_trip::<KeyframeReply>(&text),
            MapChangeNotice::NAME => assert_round_trip::<MapChangeNotice>(&text),
            RobotPose::NAME => assert_round_trip::<RobotPose>(&text),
            RobotOdometry::NAME => assert_round_trip::<RobotOdometry>(&text),
            RobotStatus::NAME => assert_round_trip::<RobotStatus>(&text),
            CellMatchReply::NAME => assert_round_trip::<CellMatchReply>(&text),
            CellLocalizeReply::NAME => assert_round_trip::<CellLocalizeReply>(&text),
            SessionPart::NAME => assert_round_trip::<SessionPart>(&text),
            SessionPartReply::NAME => assert_round_trip::<SessionPartReply>(&text),
            ErrorReply::NAME => assert_round_trip::<ErrorReply>(&text),
            other => panic!("{name} has the unknown type {other}"),
        }
    }
}

#[test]
fn every_message_type_has_an_example() {
    let examples = files("examples/json").into_values();
    let shown: BTreeSet<String> = examples.map(|path| type_of(&std::fs::read(path).unwrap())).collect();
    let mut defined = BTreeSet::new();
    for path in files("src").into_values() {
        let source = std::fs::read_to_string(path).unwrap();
        let names = source.lines().map(str::trim).filter_map(|line| {
            let constant = line.strip_prefix("const NAME: &'static str = \"");
            // In the table of messages: tag, name, type.
            let row = line.split_once(" \"").filter(|(tag, _)| tag.parse::<u16>().is_ok());
            let (name, _) = constant.or(row.map(|(_, rest)| rest))?.split_once('"')?;
            Some(name.to_owned())
        });
        defined.extend(names);
    }
    assert_eq!(shown, defined);
    // A match answer has two forms.
    let names: Vec<String> = files("examples/json").into_keys().collect();
    for form in ["match_reply_keyframe", "match_reply_done"] {
        assert!(names.iter().any(|name| name == form), "{form} is missing");
    }
}
