//! Feature tracks: which clone saw which feature where.

use crate::state::CloneId;
use nalgebra::Vector2;

/// One feature in one image, as an odometry front end reports it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackObservation {
    /// Which camera of the rig saw it.
    pub camera: u8,
    /// The front end's name of the feature; the same in all cameras of a rig.
    pub feature_id: u64,
    /// Where, in pixels as the camera saw them (distorted).
    pub pixel: Vector2<f64>,
}

/// One observation of a track.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// The clone that saw it.
    pub clone: CloneId,
    /// Which camera.
    pub camera: u8,
    /// Where, pixels.
    pub pixel: Vector2<f64>,
}

/// What was seen of one feature without a gap and not used yet.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Track {
    /// The front end's name of the feature.
    pub feature_id: u64,
    /// Oldest first.
    pub sightings: Vec<Sighting>,
}

impl Track {
    /// How many different clones saw it.
    pub fn clones(&self) -> usize {
        let mut count = 0;
        let mut last = None;
        for sighting in &self.sightings {
            if last != Some(sighting.clone) {
                count += 1;
                last = Some(sighting.clone);
            }
        }
        count
    }

    /// The clone that saw it last.
    pub fn newest(&self) -> Option<CloneId> {
        self.sightings.last().map(|sighting| sighting.clone)
    }
}

/// All running tracks.
#[derive(Clone, Debug, Default)]
pub struct TrackStore {
    /// In the order of their features' names.
    running: Vec<Track>,
    /// Memory of tracks that are over.
    spare: Vec<Vec<Sighting>>,
}

impl TrackStore {
    /// Adds the observations of the newest clone, except those of the features `kept_elsewhere`.
    pub fn add(
        &mut self,
        clone: CloneId,
        observations: &[TrackObservation],
        kept_elsewhere: impl Fn(u64) -> bool,
    ) {
        for observation in observations {
            let feature_id = observation.feature_id;
            if kept_elsewhere(feature_id) {
                continue;
            }
            let place = match self.running.binary_search_by_key(&feature_id, |track| track.feature_id) {
                Ok(place) => place,
                Err(place) => {
                    let sightings = self.spare.pop().unwrap_or_default();
                    self.running.insert(place, Track { feature_id, sightings });
                    place
                }
            };
            let sighting = Sighting { clone, camera: observation.camera, pixel: observation.pixel };
            self.running[place].sightings.push(sighting);
        }
    }

    /// Moves the tracks that the clone `newest` did not continue to `ready`. A feature that comes back after a
    /// gap begins a new track.
    pub fn take_ended(&mut self, newest: CloneId, ready: &mut Vec<Track>) {
        ready.extend(self.running.extract_if(.., |track| track.newest() != Some(newest)));
    }

    /// Moves the running tracks that `leaving` saw to `ready`: the last chance to use all of them at once. They
    /// begin anew with the next image, so that no observation is used twice.
    pub fn take_seen_by(&mut self, leaving: CloneId, ready: &mut Vec<Track>) {
        let seen =
            |track: &mut Track| track.sightings.first().is_some_and(|sighting| sighting.clone == leaving);
        ready.extend(self.running.extract_if(.., seen));
    }

    /// Takes the memory of tracks that were used.
    pub fn recycle(&mut self, used: &mut Vec<Track>) {
        self.spare.extend(used.drain(..).map(|mut track| {
            track.sightings.clear();
            track.sightings
        }));
    }

    /// Running tracks of the first camera: the oldest clone that saw each, where, and where `newest` did.
    pub fn pairs_with(
        &self,
        newest: CloneId,
    ) -> impl Iterator<Item = (CloneId, Vector2<f64>, Vector2<f64>)> + '_ {
        self.running.iter().filter_map(move |track| {
            let of_first_camera = |sighting: &&Sighting| sighting.camera == 0;
            let oldest = track.sightings.iter().find(of_first_camera)?;
            let last = track.sightings.iter().rev().find(of_first_camera)?;
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
    fn a_track_ends_at_a_gap_and_every_observation_is_given_out_once() {
        let mut store = TrackStore::default();
        let mut given = 0;
        let frames: [&[u64]; 5] = [&[1, 2, 9], &[1, 2, 9], &[1], &[1, 2, 9], &[2]];
        let mut lengths = Vec::new();
        let mut ready = Vec::new();
        for (k, frame) in frames.iter().enumerate() {
            let clone = CloneId(k as u64);
            store.add(clone, &seen(frame), |feature| feature == 9);
            store.take_ended(clone, &mut ready);
            if k == 3 {
                store.take_seen_by(CloneId(0), &mut ready);
            }
            for track in &ready {
                lengths.push((track.feature_id, track.clones()));
                given += track.sightings.len();
            }
            store.recycle(&mut ready);
        }
        // Feature 2 before its gap; feature 1 with all four of its sightings; feature 9 is kept elsewhere.
        assert_eq!(lengths, [(2, 2), (1, 4)]);
        assert_eq!(given, 6);
    }
}
