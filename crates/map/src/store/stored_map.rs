//! A map as it was read from its database.

use protocol::MapIdentity;

use crate::contents::MapContents;

/// A map as it was read from its database.
#[derive(Debug)]
#[non_exhaustive]
pub struct StoredMap {
    /// The map, sorted by id.
    pub contents: MapContents,
    /// What is in this version: see [`MapContents::digest`].
    pub digest: MapIdentity,
    /// Bytes of the map's files.
    pub bytes_on_disk: u64,
    /// Layout of its files: [`STORE_SCHEMA`](super::STORE_SCHEMA) or [`EXTENDED_STORE_SCHEMA`](super::EXTENDED_STORE_SCHEMA).
    pub schema: u16,
}

/// What a map became by being written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct SavedMap {
    /// 1 for a new map, else one more than that of the map that was replaced; of a copy, see [`MapTarget::save_copy`](super::MapTarget::save_copy).
    pub version: u64,
    /// That of the map that was replaced, else the digest of the new one.
    pub identity: MapIdentity,
}
