//! The interface of a database that holds a map.

use std::path::Path;

use super::error::DatabaseError;
use super::record::RecordError;
use crate::contents::MapContents;

/// A kind of database that holds one map in a folder of its own.
///
/// [`super::save_map`] and [`super::load_map`] use databases only through this trait, and give it a folder that
/// nobody else uses: one to write a map into that becomes visible when it is complete, and a verified copy to read. So a
/// database need not be atomic, and may write while it reads.
pub trait MapStore: Sync {
    /// Writes a map, its version and its identity. When this returns, the files are complete and no longer written to.
    ///
    /// # Arguments
    /// * `folder`: empty.
    ///
    /// # Errors
    /// [`DatabaseError::Failed`].
    fn write(&self, folder: &Path, contents: &MapContents) -> Result<(), DatabaseError>;

    /// Reads a map. The first error of the database itself ends it.
    ///
    /// # Errors
    /// [`DatabaseError`].
    fn read(&self, folder: &Path) -> Result<ReadMap, DatabaseError>;
}

/// What a database holds.
#[derive(Debug)]
pub struct ReadMap {
    /// The map, sorted by id.
    pub contents: MapContents,
    /// The records that cannot be decoded: their names, and what is wrong with them.
    pub damaged: Vec<(String, RecordError)>,
    /// The schema that it was written with.
    pub schema: u16,
}
