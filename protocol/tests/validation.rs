//! Messages that make no sense are refused on both sides, and the error names the field.

use crate::common::*;
use geometry::uncertain_pose::PoseWithCovariance;
use nalgebra::{Matrix6, Quaternion, UnitQuaternion};
use protocol::*;

/// A sound request, spoiled by `spoil`: encoding refuses it, and the error says `field` and `reason`.
fn assert_refused(field: &str, reason: &str, spoil: impl FnOnce(&mut MatchRequest)) {
    let mut request = example(match_requests());
    request.features = FeatureSet {
        pixels: vec![[1.0, 2.0], [3.0, 4.0]],
        descriptors: Descriptors { kind: DescriptorKind::Binary, width: 4, bytes: vec![0; 8] },
        extractor: String::new(),
    };
    request.prior = Some(PosePrior { global_from_camera: sound_pose() });
    encode(Format::Bincode, &request).unwrap();
    spoil(&mut request);
    for format in Format::ALL {
        let error = encode(format, &request).unwrap_err();
        let CodecError::Invalid { violation, .. } = &error else { panic!("{error}") };
        assert_eq!(violation.field, field, "{error}");
        assert!(violation.reason.contains(reason), "{error}");
    }
}

fn sound_pose() -> PoseWithCovariance {
    PoseWithCovariance { covariance: Matrix6::from_diagonal_element(0.01), ..example(poses()) }
}

fn assert_prior_refused(field: &str, reason: &str, spoil: impl FnOnce(&mut PoseWithCovariance)) {
    let field = format!("prior.global_from_camera.{field}");
    assert_refused(&field, reason, |request| spoil(&mut request.prior.as_mut().unwrap().global_from_camera));
}

#[test]
fn numbers_that_are_none() {
    for number in [f64::NAN, f64::INFINITY] {
        assert_prior_refused("translation", "not finite", |pose| pose.pose.translation.y = number);
        assert_prior_refused("covariance", "not finite", |pose| pose.covariance[(3, 2)] = number);
        let rotation = UnitQuaternion::new_unchecked(Quaternion::new(number, 0.0, 0.0, 0.0));
        assert_prior_refused("rotation", "not finite", |pose| pose.pose.rotation = rotation);
        assert_refused("gravity_in_camera", "not finite", |request| {
            request.gravity_in_camera = Some([0.0, number, 0.0]);
        });
    }
    assert_refused("features.pixels[1]", "not finite", |request| request.features.pixels[1][0] = f32::NAN);
}

#[test]
fn rotations_and_directions_that_are_not_of_norm_one() {
    for norm in [0.0, 0.999, 1.001] {
        let rotation = UnitQuaternion::new_unchecked(Quaternion::new(norm, 0.0, 0.0, 0.0));
        assert_prior_refused("rotation", "not a unit quaternion", |pose| pose.pose.rotation = rotation);
        assert_refused("gravity_in_camera", "norm", |request| {
            request.gravity_in_camera = Some([0.0, 0.0, norm]);
        });
    }
}

#[test]
fn covariances_that_are_none() {
    assert_prior_refused("covariance", "not symmetric", |pose| pose.covariance[(0, 5)] = 0.001);
    assert_prior_refused("covariance", "negative variance", |pose| pose.covariance[(2, 2)] = -1e-9);
    assert_prior_refused("covariance", "negative", |pose| {
        pose.covariance[(0, 1)] = 0.011;
        pose.covariance[(1, 0)] = 0.011;
    });
    // Every pair is allowed, all three together are not: eigenvalue 1 - 2 * 0.6 of the correlation.
    assert_prior_refused("covariance", "eigenvalue", |pose| {
        for (row, column) in [(0, 1), (1, 2), (0, 2)] {
            pose.covariance[(row, column)] = -0.006;
            pose.covariance[(column, row)] = -0.006;
        }
    });
}

#[test]
fn covariances_of_very_different_units_and_exact_ones_are_sound() {
    let mut pose = sound_pose();
    for diagonal in [[1e-14, 1e-14, 1e-14, 1e8, 1e8, 1e8], [0.0; 6], [0.0, 0.0, 0.1, 1.0, 1.0, 0.0]] {
        pose.covariance = Matrix6::from_diagonal(&diagonal.into());
        pose.validate().unwrap();
    }
    // A fully correlated pair: singular, but a covariance.
    pose.covariance = Matrix6::from_diagonal_element(1.0);
    pose.covariance[(0, 3)] = 1.0;
    pose.covariance[(3, 0)] = 1.0;
    pose.validate().unwrap();
}

#[test]
fn queries_that_cost_too_much() {
    assert_refused("features.pixels", "more than the 5000 of a query", |request| {
        let count = protocol::MAX_QUERY_FEATURES + 1;
        let width = usize::from(request.features.descriptors.width);
        request.features.pixels = vec![[1.0, 2.0]; count];
        request.features.descriptors.bytes = vec![0; count * width];
    });
    assert_refused("max_keyframes", "more than 64", |request| request.max_keyframes = 65);
}

#[test]
fn counts_that_disagree() {
    assert_refused("features.descriptors", "2 descriptors for 3 pixels", |request| {
        request.features.pixels.push([0.0, 0.0]);
    });
    assert_refused("features.descriptors.bytes", "9 bytes", |request| {
        request.features.descriptors.bytes.push(0);
    });
    assert_refused("features.descriptors.width", "zero", |request| request.features.descriptors.width = 0);
    assert_refused("features.descriptors.width", "multiple of 4", |request| {
        request.features.descriptors =
            Descriptors { kind: DescriptorKind::Float, width: 6, bytes: vec![0; 12] };
    });
    assert_refused("features.descriptors.bytes", "not finite", |request| {
        request.features.descriptors.kind = DescriptorKind::Float;
        request.features.descriptors.bytes[..4].copy_from_slice(&f32::NAN.to_le_bytes());
    });
    assert_refused("features.pixels", "more than", |request| {
        request.features.pixels = vec![[0.0, 0.0]; MAX_FEATURES + 1];
    });
    assert_refused("max_keyframes", "zero", |request| request.max_keyframes = 0);
}

#[test]
fn cameras_and_names_that_cannot_be_used() {
    assert_refused("camera", "not a usable camera", |request| request.camera.focal[0] = 0.0);
    assert_refused("camera", "not a usable camera", |request| request.camera.centre[1] = f64::NAN);
    assert_refused("robot", "'/'", |request| request.robot = "a/b".into());
}

#[test]
fn an_image_without_features_is_a_question_that_has_an_answer() {
    let mut request = example(match_requests());
    request.features.pixels.clear();
    request.features.descriptors.bytes.clear();
    for format in Format::ALL {
        assert!(
            decode::<MatchRequest>(format, &encode(format, &request).unwrap()).unwrap().features.is_empty()
        );
    }
}

#[test]
fn replies_that_contradict_themselves() {
    let mut keyframe = example(matched_keyframes());
    let one = LandmarkMatch {
        feature: 3,
        landmark: 1,
        anchor: 2,
        position_in_anchor: [0.0, 0.0, 1.0],
        distance: 0.1,
        observations: vec![KeyframePixel { keyframe: 2, pixel: [1.0, f32::NAN] }],
    };
    keyframe.matches = vec![LandmarkMatch { observations: Vec::new(), ..one.clone() }; 2];
    let violation = |reply: &MatchReply| reply.validate().unwrap_err().to_string();
    assert!(violation(&MatchReply::Keyframe(keyframe.clone())).contains("twice"));
    keyframe.matches = vec![one];
    let said = violation(&MatchReply::Keyframe(keyframe));
    assert!(said.contains("`keyframe.matches[0].observations[0].pixel` is not finite"), "{said}");

    let mut reply = example(localize_replies());
    reply.outcome = if reply.fix.is_some() { MatchOutcome::NoMatch } else { MatchOutcome::Matched };
    assert!(reply.validate().is_err());

    let both = "{\"schema\":10,\"type\":\"match_reply\",\"keyframe\":null,\"done\":null}";
    let error = decode::<MatchReply>(Format::Json, both.as_bytes()).unwrap_err();
    assert!(error.to_string().contains("either `keyframe` or `done`"), "{error}");
}

/// A server's answer with a position beyond the bound on coordinates is refused where it arrives.
#[test]
fn positions_of_answers_are_bounded() {
    let refused = |field: &str, message: &mut serde_json::Value, pointer: &str| {
        let place = message.pointer_mut(pointer).unwrap();
        let sound = std::mem::replace(place, 1e300.into());
        let bytes = message.to_string();
        let error = match message["type"].as_str().unwrap() {
            "match_reply" => decode::<MatchReply>(Format::Json, bytes.as_bytes()).unwrap_err(),
            "keyframe_reply" => decode::<KeyframeReply>(Format::Json, bytes.as_bytes()).unwrap_err(),
            "map_info_reply" => decode::<MapInfoReply>(Format::Json, bytes.as_bytes()).unwrap_err(),
            _ => decode::<LocalizeReply>(Format::Json, bytes.as_bytes()).unwrap_err(),
        };
        let CodecError::Invalid { violation, .. } = &error else { panic!("{error}") };
        assert_eq!(violation.field, field, "{error}");
        assert!(error.to_string().contains("beyond 1e7 m"), "{error}");
        *message.pointer_mut(pointer).unwrap() = sound;
    };
    let example = |name: &str| -> serde_json::Value {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/json");
        serde_json::from_slice(&std::fs::read(folder.join(name)).unwrap()).unwrap()
    };
    let mut reply = example("match_reply_keyframe.json");
    let pose = "/keyframe/keyframe/global_from_keyframe/translation/1";
    refused("keyframe.keyframe.global_from_keyframe.translation", &mut reply, pose);
    let landmark = "/keyframe/matches/0/position_in_anchor/2";
    refused("keyframe.matches[0].position_in_anchor", &mut reply, landmark);
    let mut reply = example("keyframe_reply.json");
    refused("landmarks[1].position_in_anchor", &mut reply, "/landmarks/1/position_in_anchor/0");
    let mut reply = example("map_info_reply.json");
    refused("extent.max", &mut reply, "/extent/max/2");
    let mut reply = example("localize_reply.json");
    refused("fix.global_from_camera.translation", &mut reply, "/fix/global_from_camera/translation/0");
}

/// The receiver does not rely on the sender's checks: JSON with an invalid covariance.
#[test]
fn decoding_validates_too() {
    let text = String::from_utf8(encode(Format::Json, &example(robot_odometries())).unwrap()).unwrap();
    let mut value: serde_json::Value = serde_json::from_str(&text).unwrap();
    value["local_from_imu"]["covariance"][1][1] = (-1.0).into();
    let error = decode::<RobotOdometry>(Format::Json, value.to_string().as_bytes()).unwrap_err();
    assert!(
        matches!(&error, CodecError::Invalid { violation, .. } if violation.field == "local_from_imu.covariance")
    );
    assert!(error.to_string().contains("robot_odometry"), "{error}");
}

#[test]
fn an_overlong_error_text_is_cut_and_sent() {
    let reply = ErrorReply::new(ErrorCode::Internal, "é".repeat(MAX_TEXT_BYTES));
    assert!(reply.message.len() <= MAX_TEXT_BYTES);
    encode(Format::Bincode, &reply).unwrap();
}

#[test]
fn a_part_of_a_session_is_inside_of_a_file_that_is_not_too_large() {
    let part = SessionPart { total_bytes: 100, digest: [1; 32], offset: 90, bytes: vec![0; 10] };
    assert!(part.validate().is_ok());
    for wrong in [
        SessionPart { offset: 91, ..part.clone() },
        SessionPart { offset: u64::MAX, ..part.clone() },
        SessionPart { total_bytes: 0, offset: 0, bytes: Vec::new(), ..part.clone() },
        SessionPart { total_bytes: MAX_SESSION_BYTES + 1, ..part.clone() },
        SessionPart { total_bytes: 1 << 20, bytes: vec![0; MAX_SESSION_PART_BYTES + 1], ..part.clone() },
    ] {
        assert!(wrong.validate().is_err(), "{wrong:?}");
    }
    let reply = SessionPartReply { received_bytes: MAX_SESSION_BYTES + 1, is_complete: false };
    assert!(reply.validate().is_err());
}
