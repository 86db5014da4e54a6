//! How a map differs from its last release, and from a candidate, as the page draws it.

use crate::viewed_map::rotation_wxyz;
use axum::body::Bytes;
use geometry::Pose;
use map::difference::{KeyframeDifference, MovedKeyframe, PlacedKeyframe};
use protocol::KeyframeId;
use serde::Serialize;

/// Keyframes of one kind that are drawn of a change; of more, an even sample: 5 MB.
const MAX_DRAWN: usize = 20_000;

/// How the keyframes of another release differ from those of the map that is shown.
#[derive(Clone, Debug, PartialEq)]
pub struct ViewedChange {
    /// The other release, for people, as in `release 3` and `candidate 2`.
    pub release: String,
    /// The keyframes that differ.
    pub difference: KeyframeDifference,
}

/// What is known of the releases of a map.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ViewedChanges {
    /// The version of the map that the others are compared with.
    pub version: u64,
    /// From the release before to the map that is shown.
    pub since: Option<ViewedChange>,
    /// From the map that is shown to the open candidate.
    pub candidate: Option<ViewedChange>,
}

#[derive(Serialize)]
struct DrawnPose {
    position: [f64; 3],
    rotation_wxyz: [f64; 4],
}

impl From<&Pose> for DrawnPose {
    fn from(pose: &Pose) -> Self {
        Self { position: pose.translation.into(), rotation_wxyz: rotation_wxyz(pose) }
    }
}

#[derive(Serialize)]
struct DrawnKeyframe {
    id: KeyframeId,
    #[serde(flatten)]
    pose: DrawnPose,
}

impl From<&PlacedKeyframe> for DrawnKeyframe {
    fn from(placed: &PlacedKeyframe) -> Self {
        Self { id: placed.id, pose: (&placed.global_from_keyframe).into() }
    }
}

#[derive(Serialize)]
struct DrawnMotion {
    id: KeyframeId,
    before: DrawnPose,
    now: DrawnPose,
}

impl From<&MovedKeyframe> for DrawnMotion {
    fn from(moved: &MovedKeyframe) -> Self {
        Self { id: moved.id, before: (&moved.before).into(), now: (&moved.now).into() }
    }
}

/// Keyframes of one kind: how many, and those that are drawn.
#[derive(Serialize)]
struct Drawn<T> {
    count: usize,
    drawn: Vec<T>,
}

impl<T> Drawn<T> {
    fn of<'a, S>(all: &'a [S]) -> Self
    where
        T: From<&'a S>,
    {
        let step = all.len().div_ceil(MAX_DRAWN).max(1);
        Self { count: all.len(), drawn: all.iter().step_by(step).map(T::from).collect() }
    }
}

#[derive(Serialize)]
struct DrawnChange<'a> {
    release: &'a str,
    moved: Drawn<DrawnMotion>,
    /// How far the keyframe moved that moved farthest, metres; 0 where none did.
    largest_motion_m: f64,
    added: Drawn<DrawnKeyframe>,
    removed: Drawn<DrawnKeyframe>,
}

impl<'a> DrawnChange<'a> {
    fn of(change: &'a ViewedChange) -> Self {
        let ViewedChange { release, difference } = change;
        let KeyframeDifference { moved, added, removed } = difference;
        Self {
            release,
            moved: Drawn::of(moved),
            largest_motion_m: moved.iter().map(MovedKeyframe::distance_m).fold(0.0, f64::max),
            added: Drawn::of(added),
            removed: Drawn::of(removed),
        }
    }
}

#[derive(Serialize)]
struct ChangesAnswer<'a> {
    map: &'a str,
    version: u64,
    since: Option<DrawnChange<'a>>,
    candidate: Option<DrawnChange<'a>>,
}

impl ViewedChanges {
    /// The answer to `/api/maps/{map}/changes`.
    pub(crate) fn answer(&self, map: &str) -> Bytes {
        let (since, candidate) = (self.since.as_ref(), self.candidate.as_ref());
        let answer = ChangesAnswer {
            map,
            version: self.version,
            since: since.map(DrawnChange::of),
            candidate: candidate.map(DrawnChange::of),
        };
        // Its values are finite, so that it can always be written.
        serde_json::to_vec(&answer).unwrap_or_default().into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{UnitQuaternion, Vector3};

    #[test]
    fn of_very_many_keyframes_an_even_sample_is_drawn_and_all_are_counted() {
        let pose = |id: u64| Pose::new(UnitQuaternion::identity(), Vector3::new(id as f64, 0.0, 0.0));
        let added = (0..50_000).map(|id| PlacedKeyframe { id, global_from_keyframe: pose(id) }).collect();
        let difference = KeyframeDifference { added, ..KeyframeDifference::default() };
        let since = Some(ViewedChange { release: "release 1".to_owned(), difference });
        let changes = ViewedChanges { version: 2, since, candidate: None };
        let answer: serde_json::Value = serde_json::from_slice(&changes.answer("city")).unwrap();
        let added = &answer["since"]["added"];
        let drawn = added["drawn"].as_array().unwrap();
        assert_eq!((&added["count"], drawn.len()), (&50_000.into(), 16_667));
        assert_eq!((&drawn[1]["id"], &drawn[1]["position"][0]), (&3.into(), &3.0.into()));
        assert!(answer["candidate"].is_null() && answer["since"]["largest_motion_m"] == 0.0);
    }
}
