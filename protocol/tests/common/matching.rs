//! Queries and their replies.

use super::values::*;
use nalgebra::Matrix6;
use proptest::collection::{btree_set, vec};
use proptest::option;
use proptest::prelude::*;
use protocol::*;

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

pub fn landmark_matches() -> impl Strategy<Value = Vec<LandmarkMatch>> {
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

pub fn cross_covariances() -> impl Strategy<Value = CrossCovarianceBlock> {
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

pub fn outcomes() -> impl Strategy<Value = MatchOutcome> {
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

pub fn cell_places() -> impl Strategy<Value = CellPlace> {
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

pub fn match_statuses() -> impl Strategy<Value = MatchStatus> {
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
