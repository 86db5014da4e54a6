//! Where a recording or another map is in a map: places that both show.

use std::collections::{BTreeMap, BTreeSet};

use adjustment::RelativePose;
use geometry::camera::Camera;
use geometry::pose::Pose;
use geometry::rotation;
use geometry::uncertain_pose::isotropic_covariance;
use map::contents::MapContents;
use nalgebra::Vector3;
use protocol::{FeatureSet, KeyframeId, LandmarkId};
use recognition::{LoadedMap, RecognitionOptions};

use super::error::BuildError;
use super::loop_closure::information;
use super::progress::{Progress, Stage};

/// Standard deviations of the map's keyframes while places are searched (rad, m): only relative poses are wanted.
const SEARCH_SIGMAS: [f64; 2] = [1e-5, 1e-4];
/// Places of one image that are kept: those with the most matches.
const PLACES_AN_IMAGE: usize = 4;
/// Keyframes that must agree on where the recording is.
pub(super) const MIN_AGREEING: usize = 3;
/// A place that looks like no other one counts as much as so many that do.
const TOLD_APART_WEIGHT: usize = 3;
/// Two places agree on where the recording is up to this rotation (rad) and distance (m), and ...
const AGREEMENT: [f64; 2] = [0.1, 0.5];
/// ... this part of the distance between them, for the drift of both.
const DRIFT: f64 = 0.03;

/// A keyframe of the map that shows the place of a view.
#[derive(Clone, Debug)]
pub(super) struct StoredPlace {
    /// From the keyframe of the map to the view.
    pub(super) relative: RelativePose,
    /// Features of the view and the landmarks that they show.
    pub(super) matches: Vec<(usize, LandmarkId)>,
    /// Whether it explains the image so much better than all others that the image alone tells where it is.
    pub(super) is_told_apart: bool,
}

/// A view whose place is searched.
pub(super) struct PlaceQuery<'a> {
    /// The view.
    pub(super) view: usize,
    /// The camera that saw the features.
    pub(super) camera: &'a Camera,
    /// Its pose in the frame of the view; `None` where the view is the camera.
    pub(super) view_from_camera: Option<Pose>,
    /// The number of its first feature in the view.
    pub(super) first_feature: usize,
    /// Its features.
    pub(super) features: &'a FeatureSet,
}

/// What of a map is needed to find places in it: keyframes as if they were exact, landmarks of the primary kind, and what looks alike.
pub(super) fn searchable(stored: &MapContents) -> MapContents {
    let [sigma_theta, sigma_p] = SEARCH_SIGMAS;
    let mut searched = MapContents {
        keyframes: stored.keyframes.clone(),
        landmarks: stored.landmarks.clone(),
        aliases: stored.aliases.clone(),
        ..MapContents::empty(stored.info.clone())
    };
    for keyframe in &mut searched.keyframes {
        keyframe.global_from_keyframe.covariance = isotropic_covariance(sigma_theta, sigma_p);
    }
    searched
}

/// The places of a map that views show.
#[derive(Debug, Default)]
pub(super) struct FoundPlaces {
    pub(super) places: Vec<StoredPlace>,
    /// Part of the map's views that another place of it explains as well.
    pub(super) repeating: f64,
}

/// A map that was indexed to be searched, with its keyframes as if they were exact.
pub struct SearchedMap(LoadedMap);

impl SearchedMap {
    /// # Errors
    /// [`BuildError::Index`] for a map that cannot be searched.
    pub(super) fn of(map: &MapContents) -> Result<SearchedMap, BuildError> {
        Ok(SearchedMap(LoadedMap::from_contents(searchable(map))?))
    }

    pub(super) fn loaded(&self) -> &LoadedMap {
        &self.0
    }

    fn repeating(&self) -> f64 {
        self.0.aliasing_rate().part_aliased()
    }

    /// The keyframes of the place that an image shows and no other, see [`LoadedMap::weighed_places`].
    fn told_apart(
        &self,
        query: &PlaceQuery<'_>,
        gravity_in_camera: Option<Vector3<f64>>,
    ) -> Result<BTreeSet<KeyframeId>, BuildError> {
        let options = RecognitionOptions::default();
        let places = self.0.weighed_places(query.camera, query.features, gravity_in_camera, &options)?;
        let told_apart = places.into_iter().filter(|(_, is_told_apart)| *is_told_apart);
        Ok(told_apart.map(|(place, _)| place.keyframe).collect())
    }
}

/// Searches views in a map.
///
/// # Arguments
/// * `whole`: the map that it is a part of: what looks alike elsewhere in it is not told apart.
/// * `poses`: of all views, in a frame with z up; those of the map follow them.
///
/// # Errors
/// [`BuildError::Index`], [`BuildError::Recognition`].
pub(super) fn find_places(
    stored: &MapContents,
    whole: Option<&SearchedMap>,
    queries: &[PlaceQuery<'_>],
    poses: &[Pose],
    progress: Progress<'_>,
) -> Result<FoundPlaces, BuildError> {
    let view_of: BTreeMap<u64, usize> =
        stored.keyframes.iter().map(|keyframe| keyframe.id).zip(poses.len()..).collect();
    let map = SearchedMap::of(stored)?;
    let (options, down) = (RecognitionOptions::default(), -Vector3::z());
    let mut found = Vec::new();
    for (done, query) in queries.iter().enumerate() {
        progress(Stage::PlaceRecognition, done, queries.len());
        let view = query.view;
        let global_from_camera =
            query.view_from_camera.map_or(poses[view], |camera| poses[view].compose(&camera));
        let gravity_in_camera = Some(global_from_camera.rotation.inverse() * down);
        let places = map.0.weighed_places(query.camera, query.features, gravity_in_camera, &options)?;
        let in_whole = match whole {
            Some(whole) if !places.is_empty() => Some(whole.told_apart(query, gravity_in_camera)?),
            _ => None,
        };
        for (place, is_told_apart) in places.into_iter().take(PLACES_AN_IMAGE) {
            let is_told_apart =
                in_whole.as_ref().map_or(is_told_apart, |of_whole| of_whole.contains(&place.keyframe));
            let stored_view = view_of[&place.keyframe];
            let keyframe = &stored.keyframes[stored_view - poses.len()].global_from_keyframe.pose;
            let found_pose = place.global_from_camera;
            let global_from_view = query
                .view_from_camera
                .map_or(found_pose, |camera| found_pose.change_of_child(&camera.inverse()));
            let relative = RelativePose {
                views: [stored_view, view],
                first_from_second: keyframe.inverse().compose(&global_from_view.pose),
                information: information(keyframe, &global_from_view.covariance),
            };
            let in_view =
                |(feature, landmark): (usize, LandmarkId)| (query.first_feature + feature, landmark);
            let matches = place.inliers.into_iter().map(in_view).collect();
            found.push(StoredPlace { relative, matches, is_told_apart });
        }
    }
    progress(Stage::PlaceRecognition, queries.len(), queries.len());
    Ok(FoundPlaces { places: found, repeating: whole.unwrap_or(&map).repeating() })
}

/// Where the frame of the recording is in G: by the place with which the most others agree.
pub(super) struct Alignment {
    /// Turned about the vertical only.
    pub(super) global_from_recording: Pose,
    /// The places that agree with it, the one that gives it first.
    pub(super) agreeing: Vec<StoredPlace>,
}

/// Aligns a recording with the map.
///
/// # Arguments
/// * `poses`: of the views of the recording in its own frame, then of the map's keyframes in G.
///
/// # Returns
/// `None` without any place.
pub(super) fn align(places: &[StoredPlace], poses: &[Pose]) -> Option<Alignment> {
    let measured: Vec<Pose> = places.iter().map(|place| measured(&place.relative, poses)).collect();
    let agreeing = |first: usize| -> Vec<usize> {
        let view = places[first].relative.views[1];
        let transform = turned_about_vertical(&measured[first], &poses[view]);
        let agrees = |other: &usize| {
            let pose = &poses[places[*other].relative.views[1]];
            let error = measured[*other].local(&transform.compose(pose));
            let distance = (pose.translation - poses[view].translation).norm();
            error.fixed_rows::<3>(0).norm() <= AGREEMENT[0]
                && error.fixed_rows::<3>(3).norm() <= AGREEMENT[1] + DRIFT * distance
        };
        (0..places.len()).filter(agrees).collect()
    };
    let weight = |all: &[usize]| -> usize {
        all.iter().map(|&at| if places[at].is_told_apart { TOLD_APART_WEIGHT } else { 1 }).sum()
    };
    let best = (0..places.len()).map(|first| (first, agreeing(first))).max_by_key(|(_, all)| weight(all));
    let (first, all) = best?;
    let mut agreeing: Vec<StoredPlace> = all.iter().map(|&at| places[at].clone()).collect();
    agreeing.swap(0, all.iter().position(|&at| at == first)?);
    let pose = &poses[places[first].relative.views[1]];
    Some(Alignment { global_from_recording: turned_about_vertical(&measured[first], pose), agreeing })
}

/// Number of views with a place.
pub(super) fn view_count(places: &[StoredPlace]) -> usize {
    distinct_views(places.iter())
}

/// Number of views with a place that is told apart.
pub(super) fn told_apart_count(places: &[StoredPlace]) -> usize {
    distinct_views(places.iter().filter(|place| place.is_told_apart))
}

fn distinct_views<'a>(places: impl Iterator<Item = &'a StoredPlace>) -> usize {
    places.map(|place| place.relative.views[1]).collect::<BTreeSet<_>>().len()
}

/// The pose of the view in G by a place.
fn measured(relative: &RelativePose, poses: &[Pose]) -> Pose {
    poses[relative.views[0]].compose(&relative.first_from_second)
}

/// The transform with vertical z that takes a pose to another one.
pub(super) fn turned_about_vertical(global: &Pose, own: &Pose) -> Pose {
    let turn = rotation::log(&(global.rotation * own.rotation.inverse()));
    let yaw = rotation::exp(&Vector3::new(0.0, 0.0, turn.z));
    Pose::new(yaw, global.translation - yaw * own.translation)
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix6;

    use super::*;

    /// A drive along x, five views of which look like a part of the map where they are not, two like where they are.
    #[test]
    fn places_that_look_like_no_other_one_align_against_more_that_repeat() {
        let along = |x: f64| Pose::new(rotation::exp(&Vector3::zeros()), Vector3::new(x, 0.0, 0.0));
        let mut poses: Vec<Pose> = (0..8).map(|view| along(2.0 * f64::from(view))).collect();
        let keyframe = poses.len();
        poses.push(along(0.0));
        let place = |view: usize, shift_m: f64, is_told_apart: bool| StoredPlace {
            relative: RelativePose {
                views: [keyframe, view],
                first_from_second: along(poses[view].translation.x + shift_m),
                information: Matrix6::identity(),
            },
            matches: Vec::new(),
            is_told_apart,
        };
        let mut places: Vec<StoredPlace> = (0..5).map(|view| place(view, -12.0, false)).collect();
        places.extend([5, 7].map(|view| place(view, 3.0, false)));
        let shift =
            |places: &[StoredPlace]| align(places, &poses).unwrap().global_from_recording.translation.x;
        assert!((shift(&places) + 12.0).abs() < 1e-9);
        for place in &mut places[5..] {
            place.is_told_apart = true;
        }
        assert!((shift(&places) - 3.0).abs() < 1e-9);
        let agreeing = align(&places, &poses).unwrap().agreeing;
        assert_eq!((view_count(&agreeing), told_apart_count(&agreeing)), (2, 2));
    }
}
