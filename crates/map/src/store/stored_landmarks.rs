//! The landmarks of a stored map, read one at a time.

use std::path::PathBuf;

use super::error::StoreError;
use super::folder::TemporaryCopy;
use super::guarded;
use super::map_store::OpenDatabase;
use crate::model::Landmark;

/// The landmarks of a stored map that was opened with [`open_map`](super::open_map): by far most of its bytes.
///
/// They were read once already, to verify and to count them. Whoever keeps them in a form of its own can so make room for all
/// of them first, and never has them in memory twice.
pub struct StoredLandmarks {
    /// Folder of the map.
    pub(super) map: PathBuf,
    /// An open copy of its database ...
    pub(super) database: Box<dyn OpenDatabase>,
    /// ... in this folder.
    pub(super) copy: TemporaryCopy,
    pub(super) count: usize,
    pub(super) observation_counts: Vec<u32>,
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
        let Self { map, database, copy, .. } = self;
        let read = guarded::call(|| {
            database.read_landmarks(&mut visit)?;
            database.close()
        });
        drop(copy);
        read.and_then(|result| result).map_err(|error| StoreError::unreadable(&map, error))
    }

    /// Lets go of the landmarks without reading them.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] where the database cannot be closed.
    pub fn close(self) -> Result<(), StoreError> {
        let Self { map, database, copy, .. } = self;
        let closed = guarded::call(|| database.close()).and_then(|result| result);
        drop(copy);
        closed.map_err(|error| StoreError::unreadable(&map, error))
    }
}
