//! The interface of a database that holds a map.

use std::path::Path;

use super::error::DatabaseError;
use super::record::RecordError;
use crate::contents::MapContents;
use crate::model::Landmark;

/// A kind of database that holds one map in a folder of its own.
///
/// [`super::save_map`], [`super::load_map`] and [`super::open_map`] use databases only through this trait, and give it a folder
/// that nobody else uses: one to write a map into that becomes visible when it is complete, and a verified copy to read. So a
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

    /// Opens a map to be read.
    ///
    /// # Errors
    /// [`DatabaseError`].
    fn open(&self, folder: &Path) -> Result<Box<dyn OpenDatabase>, DatabaseError>;

    /// Reads a map. The first error of the database itself ends it.
    ///
    /// # Errors
    /// [`DatabaseError`].
    fn read(&self, folder: &Path) -> Result<ReadMap, DatabaseError> {
        let database = self.open(folder)?;
        let mut read = database.read_frame()?;
        let damaged = database.read_landmarks(&mut |landmark| read.contents.landmarks.push(landmark))?;
        read.damaged.extend(damaged);
        database.close()?;
        Ok(read)
    }
}

/// An open database of a map.
pub trait OpenDatabase: Send {
    /// Reads all but the landmarks.
    ///
    /// # Errors
    /// [`DatabaseError`].
    fn read_frame(&self) -> Result<ReadMap, DatabaseError>;

    /// Reads the landmarks one at a time, by id, the observations of each by keyframe.
    ///
    /// # Returns
    /// The records that cannot be decoded, as [`ReadMap::damaged`].
    ///
    /// # Errors
    /// The first error of the database itself.
    fn read_landmarks(
        &self,
        visit: &mut dyn FnMut(Landmark),
    ) -> Result<Vec<(String, RecordError)>, DatabaseError>;

    /// Closes the database; its folder can be removed when this returns.
    ///
    /// # Errors
    /// [`DatabaseError::Failed`].
    fn close(self: Box<Self>) -> Result<(), DatabaseError>;
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
