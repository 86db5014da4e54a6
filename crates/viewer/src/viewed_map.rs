//! A map as the page draws it.

use crate::cameras::{ViewedCamera, cameras_of, joined_cameras};
use crate::viewed_part::ViewedPart;
use axum::body::Bytes;
use geometry::{Pose, PoseWithCovariance};
use map::{Alias, Keyframe, KeyframeAliases, MapContents, MapMetadata};
use nalgebra::{Matrix3, Vector3};
use protocol::{Extent, KeyframeId};
use rand::SeedableRng as _;
use rand::rngs::StdRng;
use rand::seq::SliceRandom as _;
use serde::Serialize;
use std::collections::BTreeMap;

/// Seed of the order of landmarks: the same map is drawn the same way each time.
const ORDER_SEED: u64 = 1;
/// Bytes of a landmark: three `f32`.
pub(crate) const LANDMARK_BYTES: usize = 12;
/// Landmarks in one answer: 20 MB.
pub const MAX_LANDMARKS: usize = 20_000_000 / LANDMARK_BYTES;

/// What the list of maps says about a map.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct MapSummary {
    pub(crate) name: String,
    pub(crate) identity: Option<String>,
    pub(crate) version: u64,
    /// Grows whenever the map is drawn anew.
    pub(crate) revision: u64,
    pub(crate) keyframes: usize,
    pub(crate) landmarks: usize,
    /// Where it is served by cells: those whose keyframes and landmarks these are.
    cells: Option<ViewedCells>,
    extent: Option<Extent>,
    gravity_in_global: Option<[f64; 3]>,
}

/// Cells of a map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
struct ViewedCells {
    /// At this server.
    here: usize,
    /// At all servers.
    all: usize,
}

/// A keyframe as the page draws it, in G.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct ViewedKeyframe {
    /// Its id.
    pub id: KeyframeId,
    /// Position of the camera, metres.
    pub position: [f64; 3],
    /// Rotation from the camera frame (x right, y down, z forward) to G.
    pub rotation_wxyz: [f64; 4],
    /// Covariance of the position, m^2, by rows.
    pub position_covariance: [[f64; 3]; 3],
    /// The place that it could be taken for most easily.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub alias: Option<ViewedAlias>,
}

/// A place that a keyframe could be taken for.
#[derive(Clone, Copy, Debug, Serialize)]
#[non_exhaustive]
pub struct ViewedAlias {
    /// The keyframe next to it.
    pub keyframe: KeyframeId,
    /// Natural logarithm of its odds, by the keyframe's image alone.
    pub log_odds: f64,
}

impl ViewedKeyframe {
    /// # Arguments
    /// * `aliases`: the places that it could be taken for, the most likely one first.
    pub(crate) fn of(keyframe: &Keyframe, aliases: &[Alias]) -> Self {
        let pose = &keyframe.global_from_keyframe;
        Self {
            id: keyframe.id,
            position: pose.pose.translation.into(),
            rotation_wxyz: rotation_wxyz(&pose.pose),
            position_covariance: position_covariance(pose),
            alias: aliases.first().map(|&Alias { keyframe, log_odds }| ViewedAlias { keyframe, log_odds }),
        }
    }
}

/// The places that keyframes could be taken for, by keyframe.
pub(crate) fn aliases_of(aliases: &[KeyframeAliases]) -> BTreeMap<KeyframeId, &[Alias]> {
    aliases.iter().map(|aliases| (aliases.keyframe, aliases.places.as_slice())).collect()
}

/// Quaternion of a pose, the real part first.
pub(crate) fn rotation_wxyz(pose: &Pose) -> [f64; 4] {
    let rotation = pose.rotation;
    [rotation.w, rotation.i, rotation.j, rotation.k]
}

/// Covariance of the position, m^2, by rows.
pub(crate) fn position_covariance(pose: &PoseWithCovariance) -> [[f64; 3]; 3] {
    let block: Matrix3<f64> = pose.covariance.fixed_view::<3, 3>(3, 3).into();
    // Symmetric, so that columns are rows.
    block.into()
}

/// The answer about the keyframes of a map.
#[derive(Serialize)]
struct KeyframesAnswer<'a> {
    map: &'a str,
    version: u64,
    keyframes: &'a [ViewedKeyframe],
}

/// A map as the page draws it. Its answers are written once, and shared by all readers.
#[derive(Clone, Debug)]
pub struct ViewedMap {
    pub(crate) summary: MapSummary,
    /// The keyframes as JSON.
    pub(crate) keyframes: Bytes,
    /// The cameras of the keyframes, those of most keyframes first.
    pub(crate) cameras: Vec<ViewedCamera>,
    /// Little-endian `f32` triples in G, in an order of which every beginning is an even sample.
    pub(crate) landmarks: Bytes,
}

impl ViewedMap {
    /// A map from its parts.
    ///
    /// # Arguments
    /// * `name`: under which it is shown.
    /// * `keyframes`: with the places that each could be taken for, the most likely one first.
    /// * `landmarks`: positions in G, metres.
    pub fn new<'a>(
        name: &str,
        info: &MapMetadata,
        keyframes: impl Iterator<Item = (&'a Keyframe, &'a [Alias])>,
        landmarks: impl Iterator<Item = Vector3<f64>>,
    ) -> Self {
        let stored: Vec<_> = keyframes.collect();
        let cameras = cameras_of(stored.iter().map(|(keyframe, _)| &keyframe.camera));
        let keyframes: Vec<_> =
            stored.iter().map(|(keyframe, aliases)| ViewedKeyframe::of(keyframe, aliases)).collect();
        let points: Vec<[f32; 3]> =
            landmarks.map(|position| [position.x as f32, position.y as f32, position.z as f32]).collect();
        let counts = (keyframes.len(), points.len());
        Self::drawn(name, info, counts, None, &keyframes, cameras, points)
    }

    /// A map that is served by cells, from those that a server has.
    ///
    /// # Arguments
    /// * `all_cells`: how many the map has at all servers.
    pub fn of_parts<'a>(
        name: &str,
        info: &MapMetadata,
        all_cells: usize,
        parts: impl Iterator<Item = &'a ViewedPart>,
    ) -> Self {
        let parts: Vec<&ViewedPart> = parts.collect();
        let sum = |count: fn(&ViewedPart) -> usize| parts.iter().map(|part| count(part)).sum::<usize>();
        let counts = (sum(|part| part.keyframe_count), sum(|part| part.landmark_count));
        let keyframes: Vec<ViewedKeyframe> = parts.iter().flat_map(|part| &part.keyframes).cloned().collect();
        let points = parts.iter().flat_map(|part| &part.landmarks).copied().collect();
        let cells = Some(ViewedCells { here: parts.len(), all: all_cells });
        let cameras = joined_cameras(parts.iter().flat_map(|part| &part.cameras));
        Self::drawn(name, info, counts, cells, &keyframes, cameras, points)
    }

    /// # Arguments
    /// * `counts`: of all keyframes and landmarks, of which only a sample may be drawn.
    /// * `points`: landmarks in G (m).
    fn drawn(
        name: &str,
        info: &MapMetadata,
        counts: (usize, usize),
        cells: Option<ViewedCells>,
        keyframes: &[ViewedKeyframe],
        cameras: Vec<ViewedCamera>,
        mut points: Vec<[f32; 3]>,
    ) -> Self {
        points.shuffle(&mut StdRng::seed_from_u64(ORDER_SEED));
        // More are never sent.
        points.truncate(MAX_LANDMARKS);
        let mut bytes = Vec::with_capacity(points.len() * LANDMARK_BYTES);
        for value in points.iter().flatten() {
            bytes.extend_from_slice(&value.to_le_bytes());
        }
        let summary = MapSummary {
            name: name.to_owned(),
            identity: info.identity.map(|identity| identity.to_string()),
            version: info.version,
            revision: 0,
            keyframes: counts.0,
            landmarks: counts.1,
            cells,
            extent: extent(keyframes),
            gravity_in_global: info.gravity_in_global.map(Into::into),
        };
        let answer = KeyframesAnswer { map: name, version: info.version, keyframes };
        // Its values are finite, so that it can always be written.
        let keyframes = serde_json::to_vec(&answer).unwrap_or_default().into_boxed_slice().into();
        Self { summary, keyframes, cameras, landmarks: bytes.into() }
    }

    /// A map that is in memory.
    pub fn of_contents(name: &str, contents: &MapContents) -> Self {
        let landmarks = contents.landmarks_in_global().map(|(_, position)| position);
        let aliases = aliases_of(&contents.aliases);
        let places = |keyframe: &Keyframe| aliases.get(&keyframe.id).copied().unwrap_or_default();
        let keyframes = contents.keyframes.iter().map(|keyframe| (keyframe, places(keyframe)));
        Self::new(name, &contents.info, keyframes, landmarks)
    }

    /// The name under which it is shown.
    pub fn name(&self) -> &str {
        &self.summary.name
    }

    /// Its version.
    pub fn version(&self) -> u64 {
        self.summary.version
    }
}

/// The box around all keyframes.
fn extent(keyframes: &[ViewedKeyframe]) -> Option<Extent> {
    let positions = || keyframes.iter().map(|keyframe| Vector3::from(keyframe.position));
    let min = positions().reduce(|low, position| low.inf(&position))?;
    let max = positions().reduce(|high, position| high.sup(&position))?;
    Some(Extent { min: min.into(), max: max.into() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use testing::{Place, PlaceOptions};

    #[test]
    fn the_first_landmarks_are_an_even_sample_of_all() {
        let place = Place::new(&PlaceOptions::default());
        let viewed = ViewedMap::of_contents("place", &place.map);
        let points: Vec<Vector3<f32>> = viewed
            .landmarks
            .chunks_exact(LANDMARK_BYTES)
            .map(|bytes| {
                let value = |at: usize| f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
                Vector3::new(value(0), value(4), value(8))
            })
            .collect();
        assert_eq!(points.len(), place.map.landmarks.len());
        let mean = |points: &[Vector3<f32>]| points.iter().sum::<Vector3<f32>>() / points.len() as f32;
        let all = mean(&points);
        let variance =
            points.iter().map(|point| (point - all).norm_squared()).sum::<f32>() / points.len() as f32;
        let part = points.len() / 4;
        // Five standard deviations of the mean of such a sample.
        let bound = 5.0 * (variance / part as f32).sqrt();
        assert!((mean(&points[..part]) - all).norm() < bound, "an uneven sample");
        assert!(bound < 0.3 * variance.sqrt(), "a bound that says something");
    }
}
