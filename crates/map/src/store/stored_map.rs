//! A map as it was read from its database.

use protocol::MapIdentity;

use super::error::StoreError;
use crate::contents::MapContents;

/// A map as it was read from its database.
#[derive(Debug)]
#[non_exhaustive]
pub struct StoredMap {
    /// Everything that could be read, sorted by id; it satisfies the invariants of maps if the map that was written did.
    /// Landmarks and cross-covariances that name a damaged keyframe are left out.
    pub contents: MapContents,
    /// Records that are damaged and left out. Only maps of schema 1 and 2 have any: of newer ones, damage is refused.
    pub damaged: Vec<StoreError>,
    /// The schema that the map was written with, see [`super::STORE_SCHEMA`].
    pub schema: u16,
    /// Bytes of the map's files.
    pub bytes_on_disk: u64,
}

impl StoredMap {
    /// The map, where all of it could be read.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`] for the first damaged record.
    pub fn whole(self) -> Result<MapContents, StoreError> {
        match self.damaged.into_iter().next() {
            Some(error) => Err(error),
            None => Ok(self.contents),
        }
    }
}

/// What a map became by being written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct SavedMap {
    /// 1 for a new map, else one more than that of the map that was replaced.
    pub version: u64,
    /// That of the map that was replaced, else the digest of the new one.
    pub identity: MapIdentity,
}
