//! What is encoded is what is decoded, in both formats, to the last bit.

use crate::common::*;
use nalgebra::Matrix6;
use proptest::prelude::*;
use protocol::*;

fn assert_round_trip<M: Message + PartialEq + std::fmt::Debug>(message: &M) -> Result<(), TestCaseError> {
    for format in Format::ALL {
        let bytes = encode(format, message).unwrap();
        prop_assert_eq!(&decode::<M>(format, &bytes).unwrap(), message, "through {:?}", format);
    }
    Ok(())
}

macro_rules! round_trips {
    ($($name:ident: $strategy:ident),* $(,)?) => {
        proptest! {
            #![proptest_config(ProptestConfig::with_cases(64))]
            $(#[test] fn $name(message in $strategy()) { assert_round_trip(&message)?; })*
        }
    };
}

round_trips! {
    match_request: match_requests,
    match_reply: match_replies,
    localize_request: localize_requests,
    localize_reply: localize_replies,
    map_info: map_infos,
    keyframe_reply: keyframe_replies,
    map_change: map_changes,
    robot_pose: robot_poses,
    robot_odometry: robot_odometries,
    robot_status: robot_statuses,
    error_reply: error_replies,
    cell_match_reply: cell_match_replies,
    cell_localize_reply: cell_localize_replies,
    session_part: session_parts,
    session_part_reply: session_part_replies,
}

#[test]
fn every_message_has_its_own_tag_and_name() {
    let all = [
        (MatchRequest::TAG, MatchRequest::NAME),
        (MatchReply::TAG, MatchReply::NAME),
        (LocalizeRequest::TAG, LocalizeRequest::NAME),
        (LocalizeReply::TAG, LocalizeReply::NAME),
        (MapInfoReply::TAG, MapInfoReply::NAME),
        (KeyframeReply::TAG, KeyframeReply::NAME),
        (MapChangeNotice::TAG, MapChangeNotice::NAME),
        (RobotPose::TAG, RobotPose::NAME),
        (RobotOdometry::TAG, RobotOdometry::NAME),
        (RobotStatus::TAG, RobotStatus::NAME),
        (ErrorReply::TAG, ErrorReply::NAME),
        (CellMatchReply::TAG, CellMatchReply::NAME),
        (CellLocalizeReply::TAG, CellLocalizeReply::NAME),
        (SessionPart::TAG, SessionPart::NAME),
        (SessionPartReply::TAG, SessionPartReply::NAME),
    ];
    let tags: std::collections::HashSet<_> = all.iter().map(|(tag, _)| tag).collect();
    let names: std::collections::HashSet<_> = all.iter().map(|(_, name)| name).collect();
    assert_eq!((tags.len(), names.len()), (all.len(), all.len()));
}

/// The shape that scripts rely on.
#[test]
fn json_is_what_the_documentation_shows() {
    let mut request = example(localize_requests());
    request.features = FeatureSet {
        pixels: vec![[1.5, 2.0], [3.0, 4.0]],
        descriptors: Descriptors {
            kind: DescriptorKind::Binary,
            width: 2,
            bytes: vec![0xab, 0x01, 0xff, 0x00],
        },
        extractor: "sift-1".to_owned(),
    };
    let pose = example(poses());
    request.prior = Some(PosePrior { global_from_camera: pose });
    let value: serde_json::Value = serde_json::from_slice(&encode(Format::Json, &request).unwrap()).unwrap();
    assert_eq!(value["schema"], SCHEMA_VERSION);
    assert_eq!(value["type"], "localize_request");
    let descriptors = serde_json::json!({"kind": "binary", "width": 2, "hex": ["ab01", "ff00"]});
    assert_eq!(value["features"]["descriptors"], descriptors);
    let prior = &value["prior"]["global_from_camera"];
    assert_eq!(prior["rotation_wxyz"][0], pose.pose.rotation.w);
    assert_eq!(prior["translation"][2], pose.pose.translation.z);
    assert_eq!(prior["covariance"][1][4], pose.covariance[(1, 4)]);

    let reply = MatchReply::Keyframe(example(matched_keyframes()));
    let value: serde_json::Value = serde_json::from_slice(&encode(Format::Json, &reply).unwrap()).unwrap();
    assert!(value["keyframe"]["keyframe"]["global_from_keyframe"]["covariance"].is_array());
}

/// A person's request: optional fields left out, few decimals, fields of a newer program ignored.
#[test]
fn json_written_by_hand_is_understood() {
    let text = r#"{
        "schema": 10, "comment": "by hand",
        "camera": {"width": 640, "height": 480, "focal": [500, 500], "centre": [319.5, 239.5], "distortion": {"fov": 0.9}},
        "features": {"pixels": [[10, 20]], "descriptors": {"kind": "binary", "width": 2, "hex": ["A0ff"]}},
        "prior": {"global_from_camera": {"rotation_wxyz": [0.707107, 0, 0.707107, 0], "translation": [1, 2, 3],
            "covariance": [[0.1,0,0,0,0,0],[0,0.1,0,0,0,0],[0,0,0.1,0,0,0],[0,0,0,1,0,0],[0,0,0,0,1,0],[0,0,0,0,0,1]]}}
    }"#;
    let request: LocalizeRequest = decode(Format::Json, text.as_bytes()).unwrap();
    assert_eq!(request.features.descriptors.get(0), Some(&[0xa0, 0xff][..]));
    let rotation = request.prior.unwrap().global_from_camera.pose.rotation;
    assert!((rotation.norm() - 1.0).abs() < 1e-15, "few decimals are normalized");
}

#[test]
fn a_large_image_fits_by_far() {
    let count = 2000;
    let mut request = example(match_requests());
    request.features = FeatureSet {
        pixels: vec![[1.0, 2.0]; count],
        descriptors: Descriptors { kind: DescriptorKind::Float, width: 512, bytes: vec![0; 512 * count] },
        extractor: String::new(),
    };
    let bytes = encode(Format::Bincode, &request).unwrap();
    assert!(bytes.len() < 1_100_000, "{} bytes", bytes.len());
    assert_eq!(decode::<MatchRequest>(Format::Bincode, &bytes).unwrap(), request);
}

/// The bounds of the link between robot and server: what they say must pass a radio.
#[test]
fn a_query_of_500_features_has_40_kb_and_an_answer_of_3_keyframes_120_kb_at_most() {
    let pixel = |index: usize| [index as f32 * 1.37, 479.0 - index as f32 * 0.77];
    let mut request = example(match_requests());
    let bytes = (0..500 * 64).map(|index| (index * 37 % 256) as u8).collect();
    request.features = FeatureSet {
        pixels: (0..500).map(pixel).collect(),
        descriptors: Descriptors { kind: DescriptorKind::Int8, width: 64, bytes },
        extractor: "xfeat-1".to_owned(),
    };
    request.prior = Some(PosePrior { global_from_camera: example(poses()) });
    request.held = (9_000..9_100).collect();
    let query = encode(Format::Bincode, &request).unwrap().len();
    assert!(query <= 40_000, "{query} bytes");

    // 500 matches, each landmark seen by the three keyframes sent and by four that the robot holds.
    let sent = [9_120_u64, 9_121, 9_122];
    let observations = |index: usize| {
        let seen = sent.into_iter().chain(9_000..9_004);
        seen.map(|keyframe| KeyframePixel { keyframe, pixel: pixel(index) }).collect()
    };
    let found = |index: usize| LandmarkMatch {
        feature: index as u32,
        landmark: 5_000_000 + 17 * index as u64,
        anchor: sent[index % 3],
        position_in_anchor: [0.1 * index as f64, -1.5, 7.25],
        distance: 0.125,
        observations: observations(index),
    };
    let cross = |other: u64| CrossCovarianceBlock { other, block: Matrix6::from_element(1e-4) };
    let part = |rank: usize| {
        let keyframe = KeyframeRecord { id: sent[rank], ..example(keyframe_replies()).keyframe };
        MatchReply::Keyframe(MatchedKeyframe {
            map_version: 3,
            map_identity: MapIdentity::from_bytes([7; 16]),
            rank: rank as u16,
            keyframe,
            common_error: Vec::new(),
            cross_covariances: (9_000..9_020).map(cross).collect(),
            matches: (rank * 500 / 3..(rank + 1) * 500 / 3).map(found).collect(),
        })
    };
    let answer: usize = (0..3).map(|rank| encode(Format::Bincode, &part(rank)).unwrap().len()).sum();
    assert!(answer <= 120_000, "{answer} bytes");
}
