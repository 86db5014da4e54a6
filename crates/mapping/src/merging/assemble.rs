//! Assembles the merged map.

use std::collections::{BTreeMap, BTreeSet};

use adjustment::LandmarkTie;
use geometry::pose::Pose;
use geometry::uncertain_pose::PoseWithCovariance;
use map::contents::MapContents;
use map::model::{Keyframe, LandmarkExistence};
use map::sessions::Session;
use map::{AddedFeatures, KeptImage};
use nalgebra::Vector3;
use protocol::{KeyframeId, LandmarkId};

use super::{MergeError, MergeReport};
use crate::added_features::place_added;
use crate::joint_covariance::{JointCovariance, StatedKeyframe};
use crate::session::last_keyframe;

/// The map of both: the first one with its ids, moved, and the second one with ids beyond them. A kind of features
/// that only one of them has is added in the keyframes of that one.
///
/// # Arguments
/// * `poses`: of the second map's keyframes, then of the first one's.
pub(super) fn merged(
    first: &MapContents,
    second: &MapContents,
    poses: &[Pose],
    ties: &[LandmarkTie],
    joint: &JointCovariance,
) -> Result<MapContents, MergeError> {
    let of_sessions = second.info.sessions.iter().map(|session| session.keyframe_ids[0]);
    let of_keyframes = second.keyframes.iter().map(|keyframe| keyframe.id);
    let last_keyframe = last_keyframe(first) + shift(of_sessions.chain(of_keyframes));
    let last_landmark = first.landmarks.iter().map(|landmark| landmark.id).max().unwrap_or_default()
        + shift(second.landmarks.iter().map(|landmark| landmark.id));
    let mut contents =
        MapContents { landmarks: first.landmarks.clone(), ..MapContents::empty(first.info.clone()) };
    contents.existence.clone_from(&first.existence);
    contents.info.sessions = sessions(first, second, last_keyframe);
    contents.info.sigma_px = first.info.sigma_px.max(second.info.sigma_px);
    let new = second
        .keyframes
        .iter()
        .map(|keyframe| Keyframe { id: keyframe.id + last_keyframe, ..keyframe.clone() });
    let mut keyframes: Vec<Keyframe> = new.chain(first.keyframes.iter().cloned()).collect();
    for (view, keyframe) in keyframes.iter_mut().enumerate() {
        keyframe.global_from_keyframe = PoseWithCovariance::new(poses[view], joint.own[&view]);
    }
    let id = |view: usize| keyframes[view].id;
    (contents.cross_covariances, contents.common_errors) =
        joint.of_keyframes(|view| StatedKeyframe::alone(id(view)));
    add_landmarks(&mut contents, second, poses, ties, last_keyframe, last_landmark);
    contents.keyframes = keyframes;
    contents.images.clone_from(&first.images);
    contents.images.extend(second.images.iter().map(|image| {
        let keyframe = image.keyframe + last_keyframe;
        KeptImage { keyframe, ..image.clone() }
    }));
    contents.added_features = added_features(first, second, last_keyframe);
    place_added(&mut contents);
    contents.renumber_added();
    contents.sort();
    contents.count_sessions();
    contents.validate()?;
    Ok(contents)
}

/// 1 where ids begin with 0, as those of an imported map may, so that none of them becomes the last one of the first map.
fn shift(mut ids: impl Iterator<Item = u64>) -> u64 {
    u64::from(ids.any(|id| id == 0))
}

/// The ledger of both: that of the first map, then that of the second one, whose keyframes have other ids now.
fn sessions(first: &MapContents, second: &MapContents, last_keyframe: KeyframeId) -> Vec<Session> {
    let [mut sessions, of_second] = [first, second].map(|map| {
        let mut info = map.info.clone();
        info.sessions = map.sessions_or_one(&map.info.name);
        info.sessions_with_noise()
    });
    sessions.extend(of_second.into_iter().map(|session| {
        let keyframe_ids = session.keyframe_ids.map(|id| id + last_keyframe);
        Session { keyframe_ids, ..session }
    }));
    sessions
}

/// Adds the landmarks of the second map: to those of the first one that they are, or as new ones.
fn add_landmarks(
    contents: &mut MapContents,
    second: &MapContents,
    poses: &[Pose],
    ties: &[LandmarkTie],
    last_keyframe: KeyframeId,
    last_landmark: LandmarkId,
) {
    let tie_of: BTreeMap<LandmarkId, &LandmarkTie> = ties.iter().map(|tie| (tie.ids()[1], tie)).collect();
    let index_of: BTreeMap<LandmarkId, usize> =
        contents.landmarks.iter().map(|landmark| landmark.id).zip(0..).collect();
    let is_new = |existence: &&LandmarkExistence| !tie_of.contains_key(&existence.landmark);
    let renamed = |of: &LandmarkExistence| LandmarkExistence { landmark: of.landmark + last_landmark, ..*of };
    contents.existence.extend(second.existence.iter().filter(is_new).map(renamed));
    for landmark in &second.landmarks {
        let mut of_both = landmark.clone().with_higher_ids(last_keyframe, last_landmark);
        let Some(tie) = tie_of.get(&landmark.id) else {
            contents.landmarks.push(of_both);
            continue;
        };
        let known = &mut contents.landmarks[index_of[&tie.ids()[0]]];
        if let Some(position) = tie.position_in_anchor(poses) {
            known.position_in_anchor = position;
        }
        known.observations.append(&mut of_both.observations);
    }
}

/// The added kinds of both maps.
fn added_features(
    first: &MapContents,
    second: &MapContents,
    last_keyframe: KeyframeId,
) -> Vec<AddedFeatures> {
    let mut all = first.added_features.clone();
    let ids = first.landmarks_of_kinds().flat_map(|(_, landmarks)| landmarks).map(|landmark| landmark.id);
    let last_landmark = ids.max().unwrap_or_default();
    for AddedFeatures { kind, landmarks } in &second.added_features {
        let renamed = landmarks.iter().cloned();
        let renamed = renamed.map(|landmark| landmark.with_higher_ids(last_keyframe, last_landmark + 1));
        match all.iter_mut().find(|of| of.kind.extractor == kind.extractor) {
            Some(of_both) => {
                of_both.kind.sigma_px = of_both.kind.sigma_px.max(kind.sigma_px);
                of_both.landmarks.extend(renamed);
            }
            None => all.push(AddedFeatures { kind: kind.clone(), landmarks: renamed.collect() }),
        }
    }
    all
}

/// Fills in the statistics of the merged map.
pub(super) fn fill_report(
    report: &mut MergeReport,
    first: &MapContents,
    contents: &MapContents,
    first_from_second: &Pose,
) {
    let kept: BTreeSet<KeyframeId> = first.keyframes.iter().map(|keyframe| keyframe.id).collect();
    let after: Vec<&Keyframe> =
        contents.keyframes.iter().filter(|keyframe| kept.contains(&keyframe.id)).collect();
    let per_axis = |sum: f64| (sum / (3 * first.keyframes.len()) as f64).sqrt();
    let moved = |begin: usize| {
        let squares = first.keyframes.iter().zip(&after).map(|(before, after)| {
            let error = before.global_from_keyframe.pose.local(&after.global_from_keyframe.pose);
            error.fixed_rows::<3>(begin).norm_squared()
        });
        per_axis(squares.sum())
    };
    report.moved_deg = moved(0).to_degrees();
    report.moved_m = moved(3);
    let variance = |keyframe: &Keyframe| 3.0 * keyframe.global_from_keyframe.sigma_p_m().powi(2);
    report.sigma_before_m = per_axis(first.keyframes.iter().map(variance).sum());
    report.sigma_after_m = per_axis(after.iter().map(|keyframe| variance(keyframe)).sum());
    let Pose { rotation, translation } = first_from_second;
    let yaw: Vector3<f64> = rotation.scaled_axis();
    report.first_from_second = [yaw.z.to_degrees(), translation.x, translation.y, translation.z];
}
