//! Strategies for every message.
#![allow(dead_code)] // each test file uses its part

use geometry::camera::{Camera, Distortion};
use geometry::pose::Pose;
use geometry::uncertain_pose::PoseWithCovariance;
use nalgebra::{Matrix6, Quaternion, UnitQuaternion, Vector3};
use proptest::collection::{btree_set, vec};
use proptest::option;
use proptest::prelude::*;
use protocol::*;

pub fn poses() -> impl Strategy<Value = PoseWithCovariance> {
    let factor = prop::array::uniform32(-1.0..1.0f64);
    (vec(-1.0..1.0f64, 4), prop::array::uniform3(-1e4..1e4f64), factor, 1e-6..1e3f64)
        .prop_filter("a rotation needs a direction", |(rotation, ..)| rotation.iter().any(|x| x.abs() > 1e-3))
        .prop_map(|(rotation, translation, factor, scale)| {
            let factor = Matrix6::from_fn(|row, column| factor[(6 * row + column) % 32]);
            let product = factor * factor.transpose() * scale;
            PoseWithCovariance {
                pose: Pose {
                    rotation: UnitQuaternion::new_normalize(Quaternion::from(nalgebra::Vector4::from_vec(
                        rotation,
                    ))),
                    translation: Vector3::from(translation),
                },
                covariance: (product + product.transpose()) * 0.5,
            }
        })
}

pub fn cameras() -> impl Strategy<Value = Camera> {
    let distortion = prop_oneof![
        Just(Distortion::None),
        Just(Distortion::RadialTangential([-0.283, 0.0739, 0.00019, 1.7e-5])),
        Just(Distortion::Equidistant([-0.01, 0.02, -0.03, 0.004])),
        (0.1..1.5f64).prop_map(Distortion::Fov),
        Just(Distortion::Rational([0.51, -2.7, 3e-4, -1e-4, 1.5, 0.4, -2.5, 1.4, 1e-3, -4e-4, 8e-4, 3e-4])),
        Just(Distortion::ThinPrismFisheye([-0.04, 0.01, 2e-4, -4e-4, -0.004, 8e-4, 6e-4, -9e-4])),
        (-0.9..0.9f64, 0.0..1.0f64).prop_map(|(xi, alpha)| Distortion::DoubleSphere { xi, alpha }),
        (0.0..1.0f64, 0.5..2.0f64).prop_map(|(alpha, beta)| Distortion::Eucm { alpha, beta }),
        (0.0..3.0f64).prop_map(|xi| Distortion::Omni { xi, distortion: [-0.07, 0.4, -1e-3, 8e-4] }),
    ];
    (
        1..4000u32,
        1..4000u32,
        prop::array::uniform2(100.0..1000.0f64),
        prop::array::uniform2(-1.0..2.0f64),
        distortion,
    )
        .prop_map(|(width, height, focal, [u, v], distortion)| Camera {
            width,
            height,
            focal,
            // In images, as the plausible ones are.
            centre: [u * f64::from(width), v * f64::from(height)],
            distortion,
        })
}

pub fn features() -> impl Strategy<Value = FeatureSet> {
    let binary = (1..65u16).prop_map(|width| (DescriptorKind::Binary, width));
    let float = (1..17u16).prop_map(|dimension| (DescriptorKind::Float, 4 * dimension));
    let int8 = (1..65u16).prop_map(|width| (DescriptorKind::Int8, width));
    (prop_oneof![binary, float, int8], 0..12usize).prop_flat_map(|((kind, width), count)| {
        let size = usize::from(width) * count;
        let bytes = match kind {
            DescriptorKind::Binary | DescriptorKind::Int8 => vec(any::<u8>(), size).boxed(),
            DescriptorKind::Float => vec(-1e3..1e3f32, size / 4)
                .prop_map(|numbers| numbers.iter().flat_map(|number| number.to_le_bytes()).collect())
                .boxed(),
        };
        (vec(pixels(), count), bytes).prop_map(move |(pixels, bytes)| FeatureSet {
            pixels,
            descriptors: Descriptors { kind, width, bytes },
            extractor: ["", "sift-1", "xfeat-1"][count % 3].to_owned(),
        })
    })
}

fn pixels() -> impl Strategy<Value = [f32; 2]> {
    prop::array::uniform2(-10.0..4000.0f32)
}

pub fn points() -> impl Strategy<Value = [f64; 3]> {
    prop::array::uniform3(-1e3..1e3f64)
}

pub fn directions() -> impl Strategy<Value = [f64; 3]> {
    points()
        .prop_filter("a direction needs a length", |point| Vector3::from(*point).norm() > 1e-3)
        .prop_map(|point| Vector3::from(point).normalize().into())
}

pub fn names() -> impl Strategy<Value = String> {
    "[a-zA-Z0-9_.é-]{1,30}"
}

fn priors() -> impl Strategy<Value = Option<PosePrior>> {
    option::of(poses().prop_map(|global_from_camera| PosePrior { global_from_camera }))
}

pub fn match_requests() -> impl Strategy<Value = MatchRequest> {
    let first = (names(), any::<i64>(), cameras(), features(), priors());
    let held = btree_set(any::<u64>(), 0..5).prop_map(|ids| ids.into_iter().collect());
    let second =
        (option::of(directions()), held, option::of(any::<u64>()), 1..=protocol::MAX_ANSWER_KEYFRAMES);
    (first, second).prop_map(
        |(
            (robot, stamp_ns, camera, features, prior),
            (gravity_in_camera, held, map_version_held, max_keyframes),
        )| {
            MatchRequest {
                robot,
                stamp_ns,
                camera,
                features,
                prior,
                gravity_in_camera,
                held,
                map_version_held,
                max_keyframes,
            }
        },
    )
}

fn keyframes() -> impl Strategy<Value = KeyframeRecord> {
    (any::<u64>(), any::<i64>(), poses(), cameras()).prop_map(
        |(id, stamp_ns, global_from_keyframe, camera)| KeyframeRecord {
            id,
            stamp_ns,
            global_from_keyframe,
            camera,
        },
    )
}

fn landmark_matches() -> impl Strategy<Value = Vec<LandmarkMatch>> {
    let observation =
        (any::<u64>(), pixels()).prop_map(|(keyframe, pixel)| KeyframePixel { keyframe, pixel });
    let one = (any::<u64>(), any::<u64>(), points(), 0.0..1.0f32, vec(observation, 0..4));
    vec(one, 0..6).prop_map(|parts| {
        (0..)
            .zip(parts)
            .map(|(feature, (landmark, anchor, position_in_anchor, distance, observations))| LandmarkMatch {
                feature,
                landmark,
                anchor,
                position_in_anchor,
                distance,
                observations,
            })
            .collect()
    })
}

fn identities() -> impl Strategy<Value = MapIdentity> {
    any::<[u8; 16]>().prop_map(MapIdentity::from_bytes)
}

fn cross_covariances() -> impl Strategy<Value = CrossCovarianceBlock> {
    (any::<u64>(), vec(-1.0..1.0f64, 36))
        .prop_map(|(other, block)| CrossCovarianceBlock { other, block: Matrix6::from_row_slice(&block) })
}

pub fn matched_keyframes() -> impl Strategy<Value = MatchedKeyframe> {
    let map = (any::<u64>(), identities());
    let common_error = vec(prop::array::uniform6(-1.0..1.0f64), 0..3);
    let correlations = (common_error, vec(cross_covariances(), 0..3));
    (map, any::<u16>(), keyframes(), correlations, landmark_matches()).prop_map(
        |((map_version, map_identity), rank, keyframe, (common_error, cross_covariances), matches)| {
            MatchedKeyframe {
                map_version,
                map_identity,
                rank,
                keyframe,
                common_error,
                cross_covariances,
                matches,
            }
        },
    )
}

fn outcomes() -> impl Strategy<Value = MatchOutcome> {
    prop::sample::select(vec![
        MatchOutcome::Matched,
        MatchOutcome::NoMatch,
        MatchOutcome::NotVerified,
        MatchOutcome::TooFewFeatures,
        MatchOutcome::EmptyMap,
        MatchOutcome::Ambiguous,
    ])
}

pub fn match_replies() -> impl Strategy<Value = MatchReply> {
    prop_oneof![
        matched_keyframes().prop_map(MatchReply::Keyframe),
        match_statuses().prop_map(MatchReply::Done)
    ]
}

fn cell_places() -> impl Strategy<Value = CellPlace> {
    (poses(), any::<u32>())
        .prop_map(|(global_from_camera, features)| CellPlace { global_from_camera, features })
}

pub fn cell_match_replies() -> impl Strategy<Value = CellMatchReply> {
    (vec(matched_keyframes(), 0..3), match_statuses(), option::of(cell_places())).prop_map(
        |(keyframes, status, place)| {
            let keyframes = keyframes.into_iter().map(MatchReply::Keyframe);
            CellMatchReply { replies: keyframes.chain([MatchReply::Done(status)]).collect(), place }
        },
    )
}

pub fn cell_localize_replies() -> impl Strategy<Value = CellLocalizeReply> {
    (localize_replies(), option::of(cell_places()))
        .prop_map(|(reply, place)| CellLocalizeReply { reply, place })
}

fn match_statuses() -> impl Strategy<Value = MatchStatus> {
    let numbers = (any::<u64>(), any::<u16>(), any::<u32>(), any::<u64>());
    (numbers, identities(), outcomes(), option::of(directions()), 0.1..5.0f64, -30.0..30.0f64).prop_map(
        |(
            (map_version, keyframes_sent, searched_keyframes, elapsed_us),
            map_identity,
            outcome,
            gravity_in_global,
            sigma_map_px,
            log_odds,
        )| {
            MatchStatus {
                map_version,
                map_identity,
                outcome,
                keyframes_sent,
                searched_keyframes,
                elapsed_us,
                gravity_in_global,
                sigma_map_px,
                log_odds,
                log_prior_odds: 0.1 * log_odds,
            }
        },
    )
}

pub fn localize_requests() -> impl Strategy<Value = LocalizeRequest> {
    (cameras(), features(), priors(), option::of(directions())).prop_map(
        |(camera, features, prior, gravity_in_camera)| LocalizeRequest {
            camera,
            features,
            prior,
            gravity_in_camera,
        },
    )
}

pub fn localize_replies() -> impl Strategy<Value = LocalizeReply> {
    let fix = (poses(), any::<u64>(), 0..1000u32, 0..1000u32, 0.0..20.0f64).prop_map(
        |(global_from_camera, keyframe, inliers, outliers, mean_error_px)| LocalizedPose {
            global_from_camera,
            keyframe,
            matched_features: inliers + outliers,
            inliers,
            mean_error_px,
        },
    );
    let place =
        (poses(), any::<u32>(), -30.0..30.0f64).prop_map(|(global_from_camera, features, log_odds)| {
            PossiblePlace { global_from_camera, features, log_odds }
        });
    (any::<u64>(), identities(), option::of(fix), vec(place, 0..4)).prop_map(
        |(map_version, map_identity, fix, places)| LocalizeReply {
            map_version,
            map_identity,
            outcome: if fix.is_some() { MatchOutcome::Matched } else { MatchOutcome::NoMatch },
            fix,
            places,
        },
    )
}

pub fn map_infos() -> impl Strategy<Value = MapInfoReply> {
    let counts = prop::array::uniform5(any::<u64>());
    let extent = (points(), points()).prop_map(|(a, b)| Extent {
        min: std::array::from_fn(|axis| a[axis].min(b[axis])),
        max: std::array::from_fn(|axis| a[axis].max(b[axis])),
    });
    let format = features().prop_map(|features| features.descriptors.format());
    (
        (names(), identities()),
        any::<u16>(),
        counts,
        option::of(directions()),
        option::of(extent),
        option::of(format),
        0.1..5.0f64,
    )
        .prop_map(
            |(
                (name, identity),
                database_schema,
                counts,
                gravity_in_global,
                extent,
                descriptors,
                sigma_map_px,
            )| {
                MapInfoReply {
                    name,
                    version: counts[0],
                    identity,
                    database_schema,
                    keyframes: counts[1],
                    landmarks: counts[2],
                    observations: counts[3],
                    cross_covariances: counts[4],
                    gravity_in_global,
                    extent,
                    descriptors,
                    sigma_map_px,
                    extractor: if counts[0] % 2 == 0 { String::new() } else { "sift-1".to_owned() },
                    feature_kinds: descriptors
                        .map(|descriptors| FeatureKind {
                            extractor: "sift-1".to_owned(),
                            descriptors,
                            landmarks: counts[2],
                            observations: counts[3],
                            sigma_map_px,
                        })
                        .into_iter()
                        .collect(),
                }
            },
        )
}

pub fn keyframe_replies() -> impl Strategy<Value = KeyframeReply> {
    let landmark = (any::<u64>(), any::<u64>(), points(), pixels()).prop_map(
        |(landmark, anchor, position_in_anchor, pixel)| KeyframeLandmark {
            landmark,
            anchor,
            position_in_anchor,
            pixel,
        },
    );
    (any::<u64>(), identities(), keyframes(), vec(landmark, 0..5)).prop_map(
        |(map_version, map_identity, keyframe, landmarks)| KeyframeReply {
            map_version,
            map_identity,
            keyframe,
            landmarks,
        },
    )
}

pub fn map_changes() -> impl Strategy<Value = MapChangeNotice> {
    let stated = (0.0..1.0f64, 0.0..10.0f64)
        .prop_map(|(sigma_theta_rad, sigma_p_m)| StatedChange { sigma_theta_rad, sigma_p_m });
    let ids = || vec(any::<u64>(), 0..5);
    let numbers = |most: f32| [-most..most, -most..most, -most..most];
    let motion =
        (any::<u64>(), numbers(1.0), numbers(10.0)).prop_map(|(keyframe, theta_rad, translation_m)| {
            KeyframeMotion { keyframe, theta_rad, translation_m }
        });
    let versions = (0..u64::MAX).prop_flat_map(|from| (Just(from), from + 1..=u64::MAX));
    let change = (option::of(stated), vec(motion, 0..5));
    ((names(), identities()), versions, ids(), ids(), ids(), change).prop_map(
        |((map, identity), (from_version, version), changed, moved, removed, change)| {
            let (stated_change, keyframe_motions) = change;
            MapChangeNotice {
                map,
                identity,
                from_version,
                version,
                changed,
                moved,
                removed,
                stated_change,
                keyframe_motions,
            }
        },
    )
}

pub fn robot_poses() -> impl Strategy<Value = RobotPose> {
    (any::<i64>(), names(), any::<u64>(), identities(), poses(), poses()).prop_map(
        |(stamp_ns, map, map_version, map_identity, global_from_imu, global_from_local)| RobotPose {
            stamp_ns,
            map,
            map_version,
            map_identity,
            global_from_imu,
            global_from_local,
        },
    )
}

pub fn robot_odometries() -> impl Strategy<Value = RobotOdometry> {
    (any::<i64>(), poses(), points(), points()).prop_map(
        |(stamp_ns, local_from_imu, velocity_in_local, angular_velocity_in_imu)| RobotOdometry {
            stamp_ns,
            local_from_imu,
            velocity_in_local,
            angular_velocity_in_imu,
        },
    )
}

pub fn robot_statuses() -> impl Strategy<Value = RobotStatus> {
    let states = vec![
        RobotState::OdometryOnly,
        RobotState::Localized,
        RobotState::Lost,
        RobotState::Starting,
        RobotState::Off,
    ];
    let numbers = (any::<u32>(), any::<u64>(), any::<u64>());
    (
        any::<i64>(),
        prop::sample::select(states),
        ".{0,40}",
        option::of(names()),
        option::of(any::<i64>()),
        numbers,
    )
        .prop_map(
            |(
                stamp_ns,
                state,
                reason,
                map,
                last_map_update_ns,
                (keyframes_held, queries_sent, queries_answered),
            )| {
                RobotStatus {
                    stamp_ns,
                    state,
                    reason,
                    map,
                    last_map_update_ns,
                    keyframes_held,
                    queries_sent,
                    queries_answered,
                }
            },
        )
}

pub fn error_replies() -> impl Strategy<Value = ErrorReply> {
    let codes = vec![
        ErrorCode::BadRequest,
        ErrorCode::SchemaMismatch,
        ErrorCode::DescriptorMismatch,
        ErrorCode::UnknownMap,
        ErrorCode::UnknownKeyframe,
        ErrorCode::Busy,
        ErrorCode::Internal,
    ];
    (prop::sample::select(codes), ".{0,40}").prop_map(|(code, message)| ErrorReply::new(code, message))
}

/// One value of a strategy, the same every time.
pub fn example<T: std::fmt::Debug>(strategy: impl Strategy<Value = T>) -> T {
    let mut runner = proptest::test_runner::TestRunner::deterministic();
    proptest::strategy::ValueTree::current(&strategy.new_tree(&mut runner).unwrap())
}

/// Makes length and checksum right again: what a hostile sender, rather than a bad line, would send.
pub fn resealed(payload: &[u8], tag: u16) -> Vec<u8> {
    sealed_as(SCHEMA_VERSION, payload, tag)
}

/// The envelope of any schema around a payload.
pub fn sealed_as(schema: u16, payload: &[u8], tag: u16) -> Vec<u8> {
    let mut bytes = b"DRFT".to_vec();
    bytes.extend(schema.to_le_bytes());
    bytes.extend(tag.to_le_bytes());
    bytes.extend((payload.len() as u32).to_le_bytes());
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&bytes[4..12]);
    hasher.update(payload);
    bytes.extend(hasher.finalize().to_le_bytes());
    bytes.extend(payload);
    bytes
}

pub fn session_parts() -> impl Strategy<Value = SessionPart> {
    (0..1_000_000_u64, any::<[u8; 32]>(), vec(any::<u8>(), 0..300), 0..1000_u64).prop_map(
        |(offset, digest, bytes, more)| SessionPart {
            total_bytes: offset + bytes.len() as u64 + more + 1,
            digest,
            offset,
            bytes,
        },
    )
}

pub fn session_part_replies() -> impl Strategy<Value = SessionPartReply> {
    (0..=MAX_SESSION_BYTES, any::<bool>())
        .prop_map(|(received_bytes, is_complete)| SessionPartReply { received_bytes, is_complete })
}
