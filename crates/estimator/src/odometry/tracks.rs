//! Feature tracks: the observations of each feature by the clones.

use crate::state::CloneId;
use nalgebra::Vector2;
use types::TrackObservation;

/// One observation of a track.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CloneObservation {
    /// Clone of the image.
    pub clone: CloneId,
    /// Index of the camera.
    pub camera: u8,
    /// Pixel as the camera sees it (distorted).
    pub pixel: Vector2<f64>,
}

/// The observations of one feature in consecutive images that have not been used yet.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Track {
    /// The front end's identity of the feature.
    pub feature_id: u64,
    /// Oldest first.
    pub observations: Vec<CloneObservation>,
}

impl Track {
    /// Number of different clones that observe it.
    pub fn clones(&self) -> usize {
        let mut count = 0;
        let mut last = None;
        for observation in &self.observations {
            if last != Some(observation.clone) {
                count += 1;
                last = Some(observation.clone);
            }
        }
        count
    }

    /// The last clone that observes it.
    pub fn newest(&self) -> Option<CloneId> {
        self.observations.last().map(|observation| observation.clone)
    }
}

/// The cameras of which a frame has images: those that see something. Cameras need not be triggered together, and the tracks of one
/// do not end with the image of another.
#[derive(Clone, Debug)]
pub struct ShownCameras([bool; 256]);

impl ShownCameras {
    /// Those of a frame's observations; all of a frame without any.
    pub fn of(observations: &[TrackObservation]) -> Self {
        let mut shown = [observations.is_empty(); 256];
        for observation in observations {
            shown[usize::from(observation.camera)] = true;
        }
        Self(shown)
    }

    /// Whether a camera is one of them.
    pub fn contains(&self, camera: u8) -> bool {
        self.0[usize::from(camera)]
    }
}

/// All tracks that have not ended.
#[derive(Clone, Debug, Default)]
pub struct TrackStore {
    /// Sorted by feature.
    running: Vec<Track>,
    /// Memory of finished tracks, to be reused.
    spare: Vec<Vec<CloneObservation>>,
}

impl TrackStore {
    /// Adds the observations of the newest clone, except those of SLAM features.
    pub fn add(
        &mut self,
        clone: CloneId,
        observations: &[TrackObservation],
        is_slam_feature: impl Fn(u64) -> bool,
    ) {
        for observation in observations {
            let feature_id = observation.feature_id;
            if is_slam_feature(feature_id) {
                continue;
            }
            let index = match self.running.binary_search_by_key(&feature_id, |track| track.feature_id) {
                Ok(index) => index,
                Err(index) => {
                    let observations = self.spare.pop().unwrap_or_default();
                    self.running.insert(index, Track { feature_id, observations });
                    index
                }
            };
            self.running[index].observations.push(CloneObservation {
                clone,
                camera: observation.camera,
                pixel: observation.pixel,
            });
        }
    }

    /// Moves the tracks that `newest` does not observe although it shows their camera to `finished`. A feature that is observed
    /// again later begins a new track.
    pub fn take_ended(&mut self, newest: CloneId, shown: &ShownCameras, finished: &mut Vec<Track>) {
        let has_ended = |track: &mut Track| {
            let camera = track.observations.first().map(|first| first.camera);
            track.newest() != Some(newest) && camera.is_none_or(|camera| shown.contains(camera))
        };
        finished.extend(self.running.extract_if(.., has_ended));
    }

    /// Moves the tracks that start at `clone`, which is about to be marginalized, to `finished`. Their features begin new
    /// tracks with the next image, so that no observation is used twice.
    pub fn take_starting_at(&mut self, clone: CloneId, finished: &mut Vec<Track>) {
        let starts_there =
            |track: &mut Track| track.observations.first().is_some_and(|first| first.clone == clone);
        finished.extend(self.running.extract_if(.., starts_there));
    }

    /// Takes back the memory of tracks that were used.
    pub fn recycle(&mut self, used: &mut Vec<Track>) {
        self.spare.extend(used.drain(..).map(|mut track| {
            track.observations.clear();
            track.observations
        }));
    }

    /// The tracks of a camera that `newest` observes: first clone, its pixel, pixel of `newest`. Those that several cameras see are
    /// those of the first of them.
    pub fn pairs_with(
        &self,
        newest: CloneId,
        camera: usize,
    ) -> impl Iterator<Item = (CloneId, Vector2<f64>, Vector2<f64>)> + '_ {
        self.running.iter().filter_map(move |track| {
            let of_camera = |observation: &&CloneObservation| usize::from(observation.camera) == camera;
            let first = track.observations.iter().map(|observation| observation.camera).min()?;
            if usize::from(first) != camera {
                return None;
            }
            let oldest = track.observations.iter().find(of_camera)?;
            let last = track.observations.iter().rev().find(of_camera)?;
            (last.clone == newest).then_some((oldest.clone, oldest.pixel, last.pixel))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(ids: &[u64]) -> Vec<TrackObservation> {
        ids.iter()
            .map(|&feature_id| TrackObservation { camera: 0, feature_id, pixel: Vector2::zeros() })
            .collect()
    }

    #[test]
    fn a_track_ends_at_a_gap_and_every_observation_is_used_once() {
        let mut store = TrackStore::default();
        let mut used = 0;
        let frames: [&[u64]; 5] = [&[1, 2, 9], &[1, 2, 9], &[1], &[1, 2, 9], &[2]];
        let mut lengths = Vec::new();
        let mut finished = Vec::new();
        for (k, frame) in frames.iter().enumerate() {
            let clone = CloneId(k as u64);
            store.add(clone, &seen(frame), |feature| feature == 9);
            store.take_ended(clone, &ShownCameras::of(&seen(frame)), &mut finished);
            if k == 3 {
                store.take_starting_at(CloneId(0), &mut finished);
            }
            for track in &finished {
                lengths.push((track.feature_id, track.clones()));
                used += track.observations.len();
            }
            store.recycle(&mut finished);
        }
        // Feature 2 before its gap; feature 1 with all four of its observations; feature 9 is a SLAM feature.
        assert_eq!(lengths, [(2, 2), (1, 4)]);
        assert_eq!(used, 6);
    }

    #[test]
    fn a_track_goes_on_while_its_camera_is_not_triggered_and_ends_where_it_shows_others() {
        let of = |camera: u8, ids: &[u64]| -> Vec<TrackObservation> {
            seen(ids).into_iter().map(|observation| TrackObservation { camera, ..observation }).collect()
        };
        let mut store = TrackStore::default();
        let mut ended = Vec::new();
        // Two cameras in turn; then one of them does not see feature 1, and last nobody sees anything.
        let frames = [of(0, &[1, 2]), of(1, &[5]), of(0, &[1, 2]), of(1, &[5]), of(0, &[2]), Vec::new()];
        for (k, frame) in frames.iter().enumerate() {
            let clone = CloneId(k as u64);
            let mut finished = Vec::new();
            store.add(clone, frame, |_| false);
            store.take_ended(clone, &ShownCameras::of(frame), &mut finished);
            ended.extend(finished.iter().map(|track| (k, track.feature_id, track.clones())));
        }
        assert_eq!(ended, [(4, 1, 2), (5, 2, 3), (5, 5, 2)]);
    }

    #[test]
    fn a_track_that_two_cameras_see_is_that_of_the_first() {
        let mut store = TrackStore::default();
        let of = |camera, feature_id| TrackObservation { camera, feature_id, pixel: Vector2::zeros() };
        for clone in [CloneId(0), CloneId(1)] {
            store.add(clone, &[of(0, 1), of(1, 1), of(1, 2)], |_| false);
        }
        assert_eq!([0, 1, 2].map(|camera| store.pairs_with(CloneId(1), camera).count()), [1, 1, 0]);
    }
}
