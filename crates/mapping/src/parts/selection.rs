//! The keyframes about the places that a recording shows.

use std::collections::BTreeSet;

use geometry::camera::Camera;
use map::contents::MapContents;
use nalgebra::Vector3;
use protocol::{FeatureSet, KeyframeId};
use recognition::RecognitionOptions;
use sensors::Sequence;

use crate::error::BuildError;
use crate::extension::ExtendError;
use crate::places::{MIN_AGREEING, SearchedMap};
use crate::progress::{Progress, Stage};

/// Images that are searched in the map, about: along the whole recording, of each camera.
const PROBES: usize = 40;
/// Places of one image that count: those with the most matches.
const PLACES_AN_IMAGE: usize = 2;

/// The part of a map that a recording shows.
pub struct PartShown {
    /// Its keyframes.
    pub keyframes: BTreeSet<KeyframeId>,
    /// The whole map, as it was searched.
    pub whole: SearchedMap,
}

/// The keyframes of a map about the places that a recording shows.
///
/// # Arguments
/// * `sequence`: with features as the map's.
/// * `most`: how many, at most: those that are nearest to where the recording's images are.
///
/// # Errors
/// [`ExtendError::NotConnected`] where too few of the images show the map; [`ExtendError::Build`] where the map cannot be searched.
pub fn part_shown(
    map: &MapContents,
    sequence: &Sequence,
    most: usize,
    progress: Progress<'_>,
) -> Result<PartShown, ExtendError> {
    let probes = probes(sequence);
    let whole = SearchedMap::of(map)?;
    let options = RecognitionOptions::default();
    let mut found: Vec<Vector3<f64>> = Vec::new();
    let mut images = 0;
    for (done, &(camera, features)) in probes.iter().enumerate() {
        progress(Stage::PlaceRecognition, done, probes.len());
        let places = whole.loaded().verified_places(camera, features, None, &|_| true, &options);
        let places = places.map_err(BuildError::from)?;
        images += usize::from(!places.is_empty());
        let positions = places.iter().take(PLACES_AN_IMAGE);
        found.extend(positions.map(|place| place.global_from_camera.pose.translation));
    }
    progress(Stage::PlaceRecognition, probes.len(), probes.len());
    if images < MIN_AGREEING {
        return Err(ExtendError::NotConnected {
            keyframes: probes.len(),
            found: images,
            told_apart: 0,
            agreeing: 0,
            wanted: MIN_AGREEING,
        });
    }
    let distance = |position: &Vector3<f64>| {
        let distances = found.iter().map(|place| (place - position).norm());
        distances.min_by(f64::total_cmp)
    };
    let mut near: Vec<(f64, KeyframeId)> = map
        .keyframes
        .iter()
        .filter_map(|keyframe| {
            Some((distance(&keyframe.global_from_keyframe.pose.translation)?, keyframe.id))
        })
        .collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let keyframes = near.into_iter().take(most).map(|(_, id)| id).collect();
    Ok(PartShown { keyframes, whole })
}

/// The images that are searched, with their cameras.
fn probes(sequence: &Sequence) -> Vec<(&Camera, &FeatureSet)> {
    let images: usize = sequence.frames.iter().map(|frame| frame.features.len()).sum();
    let step = images.div_ceil(PROBES).max(1);
    let mut probes = Vec::new();
    for (index, sensor) in sequence.cameras.iter().enumerate() {
        let features = sequence.frames.iter().filter_map(|frame| frame.features.get(&index));
        probes.extend(features.step_by(step).map(|features| (&sensor.camera, features)));
    }
    probes
}
