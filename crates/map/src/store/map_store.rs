//! The interface of a database that holds a map.

use std::path::Path;

use super::error::DatabaseError;
use super::record::{self, LandmarkRecord, RecordError};
use crate::contents::MapContents;
use crate::model::Landmark;
use protocol::LandmarkId;

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

    /// Reads a map.
    ///
    /// # Errors
    /// [`DatabaseError`].
    fn read(&self, folder: &Path) -> Result<MapContents, DatabaseError> {
        let database = self.open(folder)?;
        let mut contents = database.read_frame()?;
        database.read_landmarks(&mut |landmark| contents.landmarks.push(landmark))?;
        database.close()?;
        Ok(contents)
    }
}

/// Takes the id and the payload of a record.
pub type VisitRecord<'a> = dyn FnMut(LandmarkId, &[u8]) -> Result<(), RecordError> + 'a;

/// An open database of a map.
pub trait OpenDatabase: Send {
    /// Reads all but the landmarks, sorted by id.
    ///
    /// # Errors
    /// [`DatabaseError`].
    fn read_frame(&self) -> Result<MapContents, DatabaseError>;

    /// Visits the payloads of the landmarks' records one at a time, by id; the first one that cannot be used ends it.
    ///
    /// # Errors
    /// The first one of the database, or [`DatabaseError::Record`].
    fn visit_landmarks(&self, visit: &mut VisitRecord<'_>) -> Result<(), DatabaseError>;

    /// Reads the landmarks one at a time, by id, the observations of each by keyframe.
    ///
    /// # Errors
    /// The first one of the database, or [`DatabaseError::Record`].
    fn read_landmarks(&self, visit: &mut dyn FnMut(Landmark)) -> Result<(), DatabaseError> {
        self.visit_landmarks(&mut |id, payload| {
            let mut landmark = record::decode::<LandmarkRecord>(payload)?.into_landmark(id);
            landmark.observations.sort_by_key(|observation| observation.keyframe);
            visit(landmark);
            Ok(())
        })
    }

    /// Closes the database; its folder can be removed when this returns.
    ///
    /// # Errors
    /// [`DatabaseError::Failed`].
    fn close(self: Box<Self>) -> Result<(), DatabaseError>;
}
