//! A loaded map as bytes, as it is in memory: reading them takes a fraction of the time that indexing takes.
//!
//! The bytes are for the program that wrote them, to have a map out of memory for a while. They have no version and no checksum:
//! whoever keeps them makes sure that they come back as they were.

use std::io::{Read, Write};
use std::sync::Arc;

use super::loaded_map::LoadedMap;
use super::poses::MapPoses;

/// Why a map was not written, or not read back.
#[derive(Debug, thiserror::Error)]
#[error("a loaded map cannot be {done}: {source}")]
pub struct FrozenError {
    /// `written` or `read back`.
    done: &'static str,
    source: bincode::Error,
}

impl LoadedMap {
    /// Writes the map with its index.
    ///
    /// # Errors
    /// What the writer reports.
    pub fn freeze(&self, writer: impl Write) -> Result<(), FrozenError> {
        let mut writer = writer;
        bincode::serialize_into(&mut writer, &*self.poses)
            .and_then(|()| bincode::serialize_into(&mut writer, self))
            .map_err(|source| FrozenError { done: "written", source })
    }

    /// Reads what [`LoadedMap::freeze`] of this very program wrote; lengths are believed.
    ///
    /// # Errors
    /// What the reader reports, and bytes that are no map.
    pub fn thaw(reader: impl Read) -> Result<LoadedMap, FrozenError> {
        let failed = |source| FrozenError { done: "read back", source };
        let mut reader = reader;
        let poses: MapPoses = bincode::deserialize_from(&mut reader).map_err(failed)?;
        let mut map: LoadedMap = bincode::deserialize_from(&mut reader).map_err(failed)?;
        map.poses = Arc::new(poses);
        for added in &mut map.added {
            added.poses = Arc::clone(&map.poses);
        }
        Ok(map)
    }

    /// Bytes of memory that the map takes: those of its arrays, which are as long in memory as they are when written.
    pub fn bytes_in_memory(&self) -> usize {
        let [poses, others] = [bincode::serialized_size(&*self.poses), bincode::serialized_size(self)];
        let written = poses.unwrap_or(0) + others.unwrap_or(0);
        usize::try_from(written).unwrap_or(usize::MAX)
    }
}

#[cfg(test)]
mod tests {
    use allocation_counter::measure;
    use testing::{Place, PlaceOptions};

    use super::*;
    use crate::RecognitionOptions;

    fn loaded() -> (Place, LoadedMap) {
        let place = Place::new(&PlaceOptions { keyframes: 60, landmarks: 3000, ..PlaceOptions::default() });
        let map = LoadedMap::from_contents(place.map.clone()).unwrap();
        (place, map)
    }

    #[test]
    fn a_map_that_was_frozen_answers_as_before() {
        let (place, map) = loaded();
        let mut bytes = Vec::new();
        map.freeze(&mut bytes).unwrap();
        let thawed = LoadedMap::thaw(bytes.as_slice()).unwrap();
        let mut again = Vec::new();
        thawed.freeze(&mut again).unwrap();
        assert!(bytes == again, "not all of it came back");
        let mut rng = rand::SeedableRng::seed_from_u64(1);
        let rng: &mut rand::rngs::StdRng = &mut rng;
        let options = RecognitionOptions::default();
        for pose in place.path.iter().step_by(7) {
            let request = place.request(pose, 8, rng);
            let [mut before, mut after] = [&map, &thawed].map(|map| map.answer(&request, &options).unwrap());
            for replies in [&mut before, &mut after] {
                if let Some(protocol::MatchReply::Done(status)) = replies.last_mut() {
                    status.elapsed_us = 0;
                }
            }
            assert_eq!(before, after);
        }
        for cut in [0, 8, bytes.len() / 2, bytes.len() - 1] {
            assert!(LoadedMap::thaw(&bytes[..cut]).is_err());
        }
    }

    #[test]
    fn the_stated_memory_is_what_the_allocator_gave() {
        let (place, _) = loaded();
        let mut indexed = None;
        let contents = place.map.clone();
        let of_contents = {
            let mut copy = None;
            let counted = measure(|| copy = Some(place.map.clone())).bytes_current;
            drop(copy);
            counted
        };
        let beyond = measure(|| indexed = Some(LoadedMap::from_contents(contents).unwrap())).bytes_current;
        let indexed = indexed.unwrap();
        let mut bytes = Vec::new();
        indexed.freeze(&mut bytes).unwrap();
        let mut thawed = None;
        let of_thawed = measure(|| thawed = Some(LoadedMap::thaw(bytes.as_slice()).unwrap())).bytes_current;
        for (what, counted, map) in
            [("indexed", of_contents + beyond, &indexed), ("thawed", of_thawed, thawed.as_ref().unwrap())]
        {
            let ratio = map.bytes_in_memory() as f64 / counted as f64;
            assert!((0.9..1.1).contains(&ratio), "{what}: {} of {counted}", map.bytes_in_memory());
        }
    }
}
