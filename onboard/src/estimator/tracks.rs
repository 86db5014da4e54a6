//! Feature tracks: which clone saw which feature where.

use super::state::CloneId;
use nalgebra::Vector2;
use std::collections::BTreeMap;

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

    fn newest(&self) -> Option<CloneId> {
        self.sightings.last().map(|sighting| sighting.clone)
    }
}

/// All running tracks.
#[derive(Clone, Debug, Default)]
pub struct TrackStore {
    running: BTreeMap<u64, Track>,
}

impl TrackStore {
    /// Adds the observations of the newest clone.
    pub fn add(&mut self, clone: CloneId, observations: &[TrackObservation]) {
        for observation in observations {
            let sighting = Sighting { clone, camera: observation.camera, pixel: observation.pixel };
            self.running.entry(observation.feature_id).or_default().sightings.push(sighting);
        }
    }

    /// Takes the tracks that the clone `newest` did not continue. A feature that comes back after a
    /// gap begins a new track.
    pub fn take_ended(&mut self, newest: CloneId) -> Vec<Track> {
        let ended: Vec<u64> = self
            .running
            .iter()
            .filter(|(_, track)| track.newest() != Some(newest))
            .map(|(id, _)| *id)
            .collect();
        ended.iter().filter_map(|id| self.running.remove(id)).collect()
    }

    /// Takes the running tracks that `leaving` saw: the last chance to use all of them at once. They
    /// begin anew with the next image, so that no observation is used twice.
    pub fn take_seen_by(&mut self, leaving: CloneId) -> Vec<Track> {
        self.running
            .values_mut()
            .filter(|track| track.sightings.first().is_some_and(|sighting| sighting.clone == leaving))
            .map(std::mem::take)
            .collect()
    }

    /// Running tracks of the first camera: the oldest clone that saw each, where, and where `newest` did.
    pub fn pairs_with(
        &self,
        newest: CloneId,
    ) -> impl Iterator<Item = (CloneId, Vector2<f64>, Vector2<f64>)> + '_ {
        self.running.values().filter_map(move |track| {
            let of_first_camera = |sighting: &&Sighting| sighting.camera == 0;
            let oldest = track.sightings.iter().find(of_first_camera)?;
            let last = track.sightings.iter().rev().find(of_first_camera)?;
            (last.clone == newest).then_some((oldest.clone, oldest.pixel, last.pixel))
        })
    }

    /// Forgets all.
    pub fn clear(&mut self) {
        self.running.clear();
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
        let frames: [&[u64]; 5] = [&[1, 2], &[1, 2], &[1], &[1, 2], &[2]];
        let mut lengths = Vec::new();
        for (k, frame) in frames.iter().enumerate() {
            let clone = CloneId(k as u64);
            store.add(clone, &seen(frame));
            let mut taken = store.take_ended(clone);
            if k == 3 {
                taken.extend(store.take_seen_by(CloneId(0)));
            }
            for track in taken {
                lengths.push(track.clones());
                given += track.sightings.len();
            }
        }
        // Feature 2 twice; feature 1 with all four of its sightings, then as an empty rest.
        assert_eq!(lengths, [2, 4, 0]);
        assert_eq!(given, 6);
    }
}
