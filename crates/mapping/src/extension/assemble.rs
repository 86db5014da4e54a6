//! Assembles the extended map.

use std::collections::{BTreeMap, BTreeSet};

use adjustment::{Bundle, InverseDepthLandmark};
use geometry::uncertain_pose::PoseWithCovariance;
use map::contents::MapContents;
use map::model::{Landmark, Observation};
use nalgebra::Vector3;
use protocol::{KeyframeId, LandmarkId};

use super::error::ExtendError;
use super::report::ExtensionReport;
use crate::added_features::place_added;
use crate::assemble::{keyframe_id, map_contents, map_observation, stated_keyframes};
use crate::joint_covariance::{JointCovariance, StatedKeyframe};
use crate::options::MapPoses;
use crate::parts::{LocatedErrors, located_errors};
use crate::session::{enter, last_keyframe};
use crate::stored_landmarks::StoredLandmarks;
use crate::without_references::Builder;

/// The map of both: what was stored with its ids, moved, and what is new with ids beyond them. The new keyframes have no features of
/// added kinds.
pub(super) fn extended(
    stored: &MapContents,
    builder: &Builder<'_, '_>,
    both: &Bundle,
    joint: &JointCovariance,
    sigma_px: f64,
) -> Result<MapContents, ExtendError> {
    let views = builder.views.len();
    let ids = Ids::after(stored);
    let (again, new): (Vec<_>, Vec<_>) =
        both.landmarks.iter().cloned().partition(|landmark| landmark.prior.is_some());
    let of_recording = Bundle { poses: both.poses[..views].to_vec(), motions: Vec::new(), landmarks: new };
    let own = joint.own.range(..views).map(|(view, of_view)| (*view, *of_view)).collect();
    let own = JointCovariance::of_independent(own);
    let mut recording =
        map_contents(&builder.rig, &builder.views, &of_recording, Some(&own), sigma_px, &builder.options)?;

    let mut contents = MapContents {
        keyframes: stored.keyframes.clone(),
        landmarks: stored.landmarks.clone(),
        aliases: stored.aliases.clone(),
        existence: stored.existence.clone(),
        images: stored.images.clone(),
        added_features: stored.added_features.clone(),
        ..MapContents::empty(stored.info.clone())
    };
    contents.ensure_sessions(&stored.info.name);
    contents.info.sessions = contents.info.sessions_with_noise();
    contents.info.sigma_px = stored.info.sigma_px.max(sigma_px);
    for (at, keyframe) in contents.keyframes.iter_mut().enumerate() {
        let view = views + at;
        keyframe.global_from_keyframe = PoseWithCovariance::new(both.poses[view], joint.own[&view]);
    }
    for keyframe in &mut recording.keyframes {
        keyframe.id += ids.last_keyframe;
    }
    enter(&mut contents.info, builder.session(), sigma_px, &recording.keyframes);
    contents.keyframes.append(&mut recording.keyframes);
    add_observations(&mut contents.landmarks, &again, builder, ids.last_keyframe);
    if builder.options.map_poses == MapPoses::Considered {
        place_again(&mut contents, &again);
    } else {
        place_added(&mut contents);
    }
    let new = recording.landmarks.into_iter();
    contents
        .landmarks
        .extend(new.map(|landmark| landmark.with_higher_ids(ids.last_keyframe, ids.last_landmark)));
    contents.renumber_added();
    (contents.cross_covariances, contents.common_errors) =
        joint.of_keyframes(|view| match builder.views.get(view) {
            Some(content) => {
                stated_keyframes(&builder.rig, (view, content), &both.poses[view], ids.last_keyframe)
            }
            None => StatedKeyframe::alone(ids.stored[view - views]),
        });
    contents.sort();
    if builder.options.map_poses == MapPoses::Considered {
        state_located(&mut contents, stored)?;
    }
    contents.count_sessions();
    contents.validate()?;
    Ok(contents)
}

/// States the joint covariance of a map and what was located in it: that of the map as it was, and of the new keyframes in the same form.
///
/// # Arguments
/// * `contents`: sorted, with every cross-covariance of the new keyframes and none of the others.
fn state_located(contents: &mut MapContents, stored: &MapContents) -> Result<(), ExtendError> {
    contents.cross_covariances.extend(stored.cross_covariances.iter().cloned());
    contents.common_errors.clone_from(&stored.common_errors);
    if !stored.common_errors.is_empty() {
        let all: BTreeSet<KeyframeId> = stored.keyframes.iter().map(|keyframe| keyframe.id).collect();
        let LocatedErrors { common, cross } =
            located_errors(stored, &all, contents).ok_or(ExtendError::Indefinite)?;
        contents.cross_covariances.clone_from(&stored.cross_covariances);
        contents.cross_covariances.extend(cross);
        contents.common_errors.extend(common);
    }
    contents.sort();
    Ok(())
}

/// Ids of keyframes by view.
struct Ids {
    last_keyframe: KeyframeId,
    last_landmark: LandmarkId,
    stored: Vec<KeyframeId>,
}

impl Ids {
    fn after(stored: &MapContents) -> Ids {
        let keyframes: Vec<KeyframeId> = stored.keyframes.iter().map(|keyframe| keyframe.id).collect();
        Ids {
            last_keyframe: last_keyframe(stored),
            last_landmark: stored.landmarks.iter().map(|landmark| landmark.id).max().unwrap_or_default(),
            stored: keyframes,
        }
    }
}

/// Adds the observations of the recording to the landmarks of the map, and moves these to where both see them.
fn add_observations(
    landmarks: &mut [Landmark],
    again: &[InverseDepthLandmark],
    builder: &Builder<'_, '_>,
    last_keyframe: KeyframeId,
) {
    let again: BTreeMap<LandmarkId, &InverseDepthLandmark> =
        again.iter().filter_map(|landmark| Some((landmark.prior.as_ref()?.id, landmark))).collect();
    for landmark in landmarks {
        let Some(adjusted) = again.get(&landmark.id) else { continue };
        landmark.position_in_anchor = adjusted.ray.push(1.0) / adjusted.inverse_depth;
        for observation in &adjusted.observations {
            if observation.is_second || observation.view() >= builder.views.len() {
                continue;
            }
            let observed = map_observation(&builder.rig, observation.feature, &builder.views);
            let renamed = |of: Observation| Observation { keyframe: of.keyframe + last_keyframe, ..of };
            landmark.observations.extend(observed.map(renamed));
        }
    }
}

/// Moves the landmarks that were seen again to where their pixels show them from the poses that the map states.
fn place_again(contents: &mut MapContents, again: &[InverseDepthLandmark]) {
    let known = StoredLandmarks::of_map(contents);
    let placed = again.iter().filter_map(|landmark| {
        let id = landmark.prior.as_ref()?.id;
        Some((id, known.placed(id)?))
    });
    let placed: BTreeMap<LandmarkId, Vector3<f64>> = placed.collect();
    for landmark in &mut contents.landmarks {
        if let Some(position) = placed.get(&landmark.id) {
            landmark.position_in_anchor = *position;
        }
    }
}

/// The camera of each new keyframe.
pub(super) fn cameras_of_new(stored: &MapContents, builder: &Builder<'_, '_>) -> BTreeMap<KeyframeId, usize> {
    let last = last_keyframe(stored);
    let mut cameras = BTreeMap::new();
    for (view, content) in builder.views.iter().enumerate() {
        for image in &content.images {
            let id = last + keyframe_id(&builder.rig, view, image.group);
            cameras.insert(id, builder.rig.groups[image.group].first);
        }
    }
    cameras
}

/// Fills in the statistics of the extended map.
pub(super) fn fill_report(
    report: &mut ExtensionReport,
    stored: &MapContents,
    contents: &MapContents,
    both: &Bundle,
) {
    let again = || both.landmarks.iter().filter(|landmark| landmark.prior.is_some());
    report.landmarks_seen_again = again().count();
    report.observations_of_them = again().map(|landmark| landmark.observations.len() - 1).sum();
    let pairs = || stored.keyframes.iter().zip(&contents.keyframes);
    let per_axis = |sum: f64| (sum / (3 * stored.keyframes.len()) as f64).sqrt();
    let moved = |first: usize| {
        let squares = pairs().map(|(before, after)| {
            let error = before.global_from_keyframe.pose.local(&after.global_from_keyframe.pose);
            error.fixed_rows::<3>(first).norm_squared()
        });
        per_axis(squares.sum())
    };
    report.moved_deg = moved(0).to_degrees();
    report.moved_m = moved(3);
    let variance = |pose: &PoseWithCovariance| 3.0 * pose.sigma_p_m().powi(2);
    report.sigma_before_m = per_axis(pairs().map(|(before, _)| variance(&before.global_from_keyframe)).sum());
    report.sigma_after_m = per_axis(pairs().map(|(_, after)| variance(&after.global_from_keyframe)).sum());
    report.keyframes = contents.keyframes.len();
    report.landmarks = contents.landmarks.len();
}
