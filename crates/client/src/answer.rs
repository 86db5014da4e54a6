//! From the wire to the estimator's terms.

use estimator::{MapAnswer, MapKeyframe, MatchedLandmark};
use nalgebra::{Vector2, Vector3};
use protocol::{FeatureSet, KeyframeId, MatchStatus, MatchedKeyframe};

/// Puts the replies to one query together.
///
/// Matches that point to a feature that was not asked about, or to a keyframe that was not sent, are
/// left out: a server's mistake is not the robot's.
///
/// # Arguments
/// * `held`: keyframes that the query said to be held.
pub fn map_answer(
    features: &FeatureSet,
    held: &[KeyframeId],
    status: &MatchStatus,
    mut replies: Vec<MatchedKeyframe>,
) -> MapAnswer {
    replies.sort_by_key(|reply| reply.rank);
    replies.retain(|reply| reply.map_version == status.map_version);
    let landmarks = replies
        .iter()
        .flat_map(|reply| &reply.matches)
        .filter_map(|found| {
            let pixel = features.pixels.get(found.feature as usize)?;
            Some(MatchedLandmark {
                pixel: pixel_of(*pixel),
                anchor: found.anchor,
                position_in_anchor: Vector3::from(found.position_in_anchor),
                observations: found
                    .observations
                    .iter()
                    .map(|seen| (seen.keyframe, pixel_of(seen.pixel)))
                    .collect(),
            })
        })
        .collect();
    let keyframes = replies
        .into_iter()
        .map(|reply| MapKeyframe {
            id: reply.keyframe.id,
            global_from_keyframe: reply.keyframe.global_from_keyframe,
            camera: reply.keyframe.camera,
            cross_covariances: reply
                .cross_covariances
                .iter()
                .map(|cross| (cross.other, cross.block))
                .collect(),
        })
        .collect();
    MapAnswer {
        map_version: status.map_version,
        keyframes,
        held_at_query: held.to_vec(),
        landmarks,
        gravity_in_global: status.gravity_in_global.map(Vector3::from),
        sigma_map_px: status.sigma_map_px,
    }
}

fn pixel_of(pixel: [f32; 2]) -> Vector2<f64> {
    Vector2::new(f64::from(pixel[0]), f64::from(pixel[1]))
}
