//! Landmarks of the map that the recording sees again.

use std::collections::{BTreeMap, BTreeSet};

use adjustment::{InverseDepthLandmark, LandmarkObservation};
use map::contents::MapContents;
use protocol::LandmarkId;

use crate::camera::Rig;
use crate::keyframe_view::{FeatureId, KeyframeView};
use crate::places::StoredPlace;
use crate::stored_landmarks::StoredLandmarks;

/// Joins the landmarks of a recording with those of the map that they are.
///
/// # Arguments
/// * `landmarks`: of the recording, by the views.
///
/// # Returns
/// The landmarks that are new, and those of the map, each with its prior and all observations of the recording.
pub(super) fn fuse(
    stored: &MapContents,
    rig: &Rig,
    views: &[KeyframeView<'_>],
    places: &[StoredPlace],
    landmarks: Vec<InverseDepthLandmark>,
) -> Vec<InverseDepthLandmark> {
    let mut shown = shown_landmarks(places);
    let mut seen: BTreeMap<LandmarkId, Vec<LandmarkObservation>> = BTreeMap::new();
    let mut fused = Vec::with_capacity(landmarks.len());
    for landmark in landmarks {
        let features = landmark.observations.iter().map(|observation| observation.feature);
        let ids = features.filter_map(|feature| shown.get(&feature).copied());
        let Some(id) = most_frequent(ids) else {
            fused.push(landmark);
            continue;
        };
        for observation in &landmark.observations {
            shown.remove(&observation.feature);
        }
        seen.entry(id).or_default().extend(landmark.observations);
    }
    for ((view, feature), id) in shown {
        seen.entry(id).or_default().extend(rig.observations((view, feature), &views[view]));
    }
    let known = StoredLandmarks::of_map(stored);
    fused.extend(seen.into_iter().filter_map(|(id, observations)| {
        Some(observed(rig, known.with_prior(id, views.len())?, observations))
    }));
    fused
}

/// The landmark that each feature shows: the one that most keyframes of the map say.
fn shown_landmarks(places: &[StoredPlace]) -> BTreeMap<FeatureId, LandmarkId> {
    let mut said: BTreeMap<FeatureId, Vec<LandmarkId>> = BTreeMap::new();
    for place in places {
        for &(feature, id) in &place.matches {
            said.entry((place.relative.views[1], feature)).or_default().push(id);
        }
    }
    said.into_iter().filter_map(|(feature, ids)| Some((feature, most_frequent(ids.into_iter())?))).collect()
}

/// The most frequent of some ids, of several the smallest.
fn most_frequent(ids: impl Iterator<Item = LandmarkId>) -> Option<LandmarkId> {
    let mut counts: BTreeMap<LandmarkId, usize> = BTreeMap::new();
    for id in ids {
        *counts.entry(id).or_default() += 1;
    }
    counts.into_iter().max_by_key(|&(id, count)| (count, std::cmp::Reverse(id))).map(|(id, _)| id)
}

/// Adds observations, one for each view and camera. The anchor's view comes last of all.
fn observed(
    rig: &Rig,
    landmark: InverseDepthLandmark,
    mut observations: Vec<LandmarkObservation>,
) -> InverseDepthLandmark {
    observations.sort_by_key(|observation| (observation.view(), observation.feature.1, observation.camera));
    let mut feature_of: BTreeMap<(usize, usize), usize> = BTreeMap::new();
    observations.retain(|observation| {
        let (view, feature) = observation.feature;
        let first_camera = rig.first_camera(observation.camera);
        *feature_of.entry((view, first_camera)).or_insert(feature) == feature
    });
    let mut unique = BTreeSet::new();
    observations.retain(|observation| unique.insert((observation.view(), observation.camera)));
    let anchor = observations.len();
    observations.extend(landmark.observations);
    InverseDepthLandmark { anchor, observations, ..landmark }
}
