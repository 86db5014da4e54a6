//! Conversion of map messages to the estimator's types.

use estimator::{ChangeSize, KeyframeMotion, MapAnswer, MapKeyframe, MapRevision, MatchedLandmark};
use nalgebra::{Matrix6xX, Vector2, Vector3};
use protocol::{FeatureSet, KeyframeId, MapChangeNotice, MapIdentity, MatchStatus, MatchedKeyframe};

/// Assembles the replies to one query.
///
/// Matches of features that are not in the query are ignored.
///
/// # Arguments
/// * `camera`: whose image was queried.
/// * `features`: of the query.
/// * `held`: keyframes in the robot's state at the time of the query.
/// * `replies`: in any order; those of another map or map version than the status are ignored.
pub fn map_answer(
    camera: usize,
    features: &FeatureSet,
    held: &[KeyframeId],
    status: &MatchStatus,
    mut replies: Vec<MatchedKeyframe>,
) -> MapAnswer {
    replies.sort_by_key(|reply| reply.rank);
    let of_status = |reply: &MatchedKeyframe| {
        (reply.map_version, reply.map_identity) == (status.map_version, status.map_identity)
    };
    replies.retain(of_status);
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
            common_error: Matrix6xX::from_column_slice(reply.common_error.as_flattened()),
            cross_covariances: reply
                .cross_covariances
                .iter()
                .map(|cross| (cross.other, cross.block))
                .collect(),
        })
        .collect();
    MapAnswer {
        map_version: status.map_version,
        map_identity: identity_number(status.map_identity),
        camera,
        keyframes,
        held_at_query: held.to_vec(),
        landmarks,
        gravity_in_global: status.gravity_in_global.map(Vector3::from),
        sigma_map_px: status.sigma_map_px,
        log_odds: status.log_odds,
        log_prior_odds: status.log_prior_odds,
    }
}

/// The estimator's form of the identity of a map.
pub fn identity_number(identity: MapIdentity) -> u128 {
    u128::from_be_bytes(identity.to_bytes())
}

/// The identity of a map that the estimator names.
pub fn map_identity(number: u128) -> MapIdentity {
    MapIdentity::from_bytes(number.to_be_bytes())
}

fn pixel_of(pixel: [f32; 2]) -> Vector2<f64> {
    Vector2::new(f64::from(pixel[0]), f64::from(pixel[1]))
}

/// The estimator's form of a map change.
pub fn map_revision(notice: MapChangeNotice) -> MapRevision {
    let size = notice.stated_change.map(|size| ChangeSize {
        sigma_rotation_rad: size.sigma_theta_rad,
        sigma_position_m: size.sigma_p_m,
    });
    let mut changed_keyframes = notice.moved;
    changed_keyframes.extend(notice.removed);
    let moved = notice.keyframe_motions.iter();
    let keyframe_motions =
        moved.map(|moved| KeyframeMotion { id: moved.keyframe, motion: moved.to_vector() }).collect();
    MapRevision {
        from_version: notice.from_version,
        version: notice.version,
        changed_keyframes,
        size,
        keyframe_motions,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector6;
    use protocol::StatedChange;

    #[test]
    fn a_revision_names_the_keyframes_with_changed_keyframes_and_the_size_of_the_change() {
        let revision = map_revision(MapChangeNotice {
            map: "hall".to_owned(),
            identity: MapIdentity::from_bytes([7; 16]),
            from_version: 3,
            version: 4,
            changed: vec![1, 2, 5],
            moved: vec![2, 5],
            removed: vec![9],
            stated_change: Some(StatedChange { sigma_theta_rad: 0.01, sigma_p_m: 0.2 }),
            keyframe_motions: vec![protocol::KeyframeMotion {
                keyframe: 5,
                theta_rad: [0.5, 0.25, 0.0],
                translation_m: [1.0, -2.0, 0.125],
            }],
        });
        assert_eq!((revision.from_version, revision.version), (3, 4));
        assert_eq!(revision.changed_keyframes, [2, 5, 9]);
        assert_eq!(revision.size, Some(ChangeSize { sigma_rotation_rad: 0.01, sigma_position_m: 0.2 }));
        let motion = Vector6::new(0.5, 0.25, 0.0, 1.0, -2.0, 0.125);
        assert_eq!(revision.keyframe_motions, [KeyframeMotion { id: 5, motion }]);
    }
}
