//! The landmarks of a stored map, read one at a time.

use std::path::PathBuf;

use super::error::{Damage, StoreError};
use super::folder::TemporaryCopy;
use super::guarded;
use super::map_store::OpenDatabase;
use crate::model::Landmark;

/// The landmarks of a stored map that was opened with [`open_map`](super::open_map): by far most of its bytes.
///
/// They were read once already, to verify and to count them. Whoever keeps them in a form of its own can so make room for all
/// of them first, and never has them in memory twice.
pub struct StoredLandmarks {
    pub(super) source: LandmarkSource,
    pub(super) count: usize,
    pub(super) observation_counts: Vec<u32>,
}

/// Where the landmarks are.
pub(super) enum LandmarkSource {
    /// Those of a map of an older schema.
    Memory(Vec<Landmark>),
    /// A map and an open copy of its database.
    Database { map: PathBuf, database: Box<dyn OpenDatabase>, copy: TemporaryCopy },
}

impl StoredLandmarks {
    /// Number of landmarks.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Number of observations by each keyframe, in the order of the map's keyframes.
    pub fn observation_counts(&self) -> &[u32] {
        &self.observation_counts
    }

    /// Calls `visit` with each landmark by id, the observations of each sorted by keyframe.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] where the database fails now.
    pub fn read(self, mut visit: impl FnMut(Landmark)) -> Result<(), StoreError> {
        match self.source {
            LandmarkSource::Memory(landmarks) => landmarks.into_iter().for_each(visit),
            LandmarkSource::Database { map, database, copy } => {
                let read = guarded::call(|| {
                    let damaged = database.read_landmarks(&mut visit)?;
                    database.close()?;
                    Ok(damaged)
                });
                let damaged =
                    read.and_then(|result| result).map_err(|error| StoreError::unreadable(&map, error))?;
                if !damaged.is_empty() {
                    return Err(StoreError::Damaged { path: map, damage: Damage::Contents });
                }
                drop(copy);
            }
        }
        Ok(())
    }

    /// Lets go of the landmarks without reading them.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] where the database cannot be closed.
    pub fn close(self) -> Result<(), StoreError> {
        let LandmarkSource::Database { map, database, copy } = self.source else { return Ok(()) };
        let closed = guarded::call(|| database.close()).and_then(|result| result);
        drop(copy);
        closed.map_err(|error| StoreError::unreadable(&map, error))
    }
}
