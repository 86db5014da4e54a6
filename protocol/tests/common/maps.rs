//! Messages about maps.

use super::values::*;
use proptest::collection::vec;
use proptest::option;
use proptest::prelude::*;
use protocol::*;

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
