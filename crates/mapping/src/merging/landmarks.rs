//! Landmarks that two maps have in common.

use std::collections::{BTreeMap, BTreeSet};

use adjustment::LandmarkTie;
use geometry::camera::Camera;
use geometry::pose::Pose;
use map::contents::MapContents;
use protocol::{DescriptorFormat, FeatureSet, KeyframeId, LandmarkId};

use crate::places::{PlaceQuery, StoredPlace};
use crate::stored_landmarks::StoredLandmarks;

/// What a keyframe of a map sees: its observations of landmarks.
pub(super) struct KeyframeFeatures<'a> {
    view: usize,
    camera: &'a Camera,
    features: FeatureSet,
    /// The landmark of each feature.
    landmarks: Vec<LandmarkId>,
}

impl KeyframeFeatures<'_> {
    /// Those of all keyframes, in the order of the map.
    pub(super) fn of_map(map: &MapContents) -> Vec<KeyframeFeatures<'_>> {
        let info = &map.info;
        let format = DescriptorFormat { kind: info.descriptor_kind, width: info.descriptor_width };
        let view_of: BTreeMap<KeyframeId, usize> =
            map.keyframes.iter().map(|keyframe| keyframe.id).zip(0..).collect();
        let without = FeatureSet { extractor: info.extractor.clone(), ..FeatureSet::empty(format) };
        let cameras = map.keyframes.iter().map(|keyframe| &keyframe.camera).enumerate();
        let empty = |(view, camera)| KeyframeFeatures {
            view,
            camera,
            features: without.clone(),
            landmarks: Vec::new(),
        };
        let mut all: Vec<KeyframeFeatures<'_>> = cameras.map(empty).collect();
        for landmark in &map.landmarks {
            for observation in &landmark.observations {
                let Some(&view) = view_of.get(&observation.keyframe) else { continue };
                let of_keyframe = &mut all[view];
                of_keyframe.features.pixels.push(observation.pixel);
                of_keyframe.features.descriptors.bytes.extend(&observation.descriptor);
                of_keyframe.landmarks.push(landmark.id);
            }
        }
        all
    }

    /// The landmark of each feature.
    pub(super) fn landmarks(&self) -> &[LandmarkId] {
        &self.landmarks
    }

    /// The query for its place.
    pub(super) fn query(&self) -> PlaceQuery<'_> {
        PlaceQuery {
            view: self.view,
            camera: self.camera,
            view_from_camera: None,
            first_feature: 0,
            features: &self.features,
        }
    }
}

/// Ties the landmarks that keyframes of both maps see at the same places, each with one other only.
///
/// # Arguments
/// * `features`: of the second map, whose views come first.
/// * `poses`: of all views.
pub(super) fn ties(
    first: &MapContents,
    second: &MapContents,
    features: &[KeyframeFeatures<'_>],
    places: &[StoredPlace],
    poses: &[Pose],
) -> Vec<LandmarkTie> {
    let mut votes: BTreeMap<(LandmarkId, LandmarkId), usize> = BTreeMap::new();
    for place in places {
        let shown = &features[place.relative.views[1]].landmarks;
        for &(feature, id) in &place.matches {
            *votes.entry((id, shown[feature])).or_default() += 1;
        }
    }
    let mut pairs: Vec<((LandmarkId, LandmarkId), usize)> = votes.into_iter().collect();
    pairs.sort_by_key(|&(ids, count)| (std::cmp::Reverse(count), ids));
    let (mut of_first, mut of_second) = (BTreeSet::new(), BTreeSet::new());
    let [one, other] = [first, second].map(StoredLandmarks::of_map);
    let tied = |a, b| LandmarkTie::new(one.with_prior(a, features.len())?, other.with_prior(b, 0)?, poses);
    pairs
        .into_iter()
        .filter_map(|((a, b), _)| {
            let is_new = !of_first.contains(&a) && !of_second.contains(&b);
            let tie = is_new.then(|| tied(a, b)).flatten()?;
            of_first.insert(a);
            of_second.insert(b);
            Some(tie)
        })
        .collect()
}
