//! The interface of a map store.

use super::error::StoreError;
use crate::contents::MapContents;
use crate::model::{Keyframe, KeyframeCrossCovariance, Landmark, MapMetadata};

/// Boxed iterator over records, each of which may be damaged by itself.
pub type Records<'a, T> = Box<dyn Iterator<Item = Result<T, StoreError>> + 'a>;

/// A map in a database.
///
/// Programs use maps only through this trait, so the database can be exchanged: implement it, and return it from
/// [`super::open`] and [`super::create`]. Reads see the newest acknowledged version. Iterators return records by
/// ascending id and continue after a damaged one.
///
/// # Example
/// A store in memory:
/// ```
/// use std::sync::Mutex;
///
/// use map::{
///     Keyframe, KeyframeCrossCovariance, Landmark, MapContents, MapMetadata, MapStore, Records, StoreError,
/// };
/// use protocol::DescriptorKind;
///
/// struct MemoryStore(Mutex<MapContents>);
///
/// impl MemoryStore {
///     fn contents(&self) -> MapContents {
///         self.0.lock().unwrap().clone()
///     }
/// }
///
/// impl MapStore for MemoryStore {
///     fn info(&self) -> Result<MapMetadata, StoreError> {
///         Ok(self.contents().info)
///     }
///
///     fn keyframes(&self) -> Records<'_, Keyframe> {
///         Box::new(self.contents().keyframes.into_iter().map(Ok))
///     }
///
///     fn landmarks(&self) -> Records<'_, Landmark> {
///         Box::new(self.contents().landmarks.into_iter().map(Ok))
///     }
///
///     fn cross_covariances(&self) -> Records<'_, KeyframeCrossCovariance> {
///         Box::new(self.contents().cross_covariances.into_iter().map(Ok))
///     }
///
///     fn replace_all(&self, contents: &MapContents) -> Result<u64, StoreError> {
///         contents.validate()?;
///         let mut stored = self.0.lock().unwrap();
///         let version = stored.info.version + 1;
///         *stored = contents.clone();
///         stored.info.version = version;
///         stored.sort();
///         Ok(version)
///     }
///
///     fn size_on_disk(&self) -> Result<u64, StoreError> {
///         Ok(0)
///     }
/// }
///
/// let empty = MapContents::empty(MapMetadata::new("hall", "example", DescriptorKind::Binary, 32));
/// let store: Box<dyn MapStore> = Box::new(MemoryStore(Mutex::new(empty.clone())));
/// assert_eq!(store.replace_all(&empty)?, 1);
/// assert_eq!(store.read_contents()?.info.version, 1);
/// # Ok::<(), StoreError>(())
/// ```
pub trait MapStore: Send + Sync {
    /// What applies to the map as a whole, with the current version.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`], [`StoreError::Database`].
    fn info(&self) -> Result<MapMetadata, StoreError>;

    /// All keyframes by id.
    fn keyframes(&self) -> Records<'_, Keyframe>;

    /// All landmarks by id.
    fn landmarks(&self) -> Records<'_, Landmark>;

    /// All cross-covariances by (a, b), `a < b`.
    fn cross_covariances(&self) -> Records<'_, KeyframeCrossCovariance>;

    /// Replaces the whole map by `contents` in one atomic step. When this returns, the new version is on the disk and
    /// survives a crash.
    ///
    /// # Returns
    /// The new version of the map, one more than the old one; that of `contents` is ignored.
    ///
    /// # Errors
    /// [`StoreError::Invalid`] (nothing is written), [`StoreError::Corrupt`] where the old version cannot be read,
    /// [`StoreError::Database`].
    fn replace_all(&self, contents: &MapContents) -> Result<u64, StoreError>;

    /// Bytes that the map takes on disk.
    ///
    /// # Errors
    /// [`StoreError::Database`].
    fn size_on_disk(&self) -> Result<u64, StoreError>;

    /// The whole map, sorted by id.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`] for the first damaged record, [`StoreError::Database`].
    fn read_contents(&self) -> Result<MapContents, StoreError> {
        let mut contents = MapContents {
            info: self.info()?,
            keyframes: self.keyframes().collect::<Result<_, _>>()?,
            landmarks: self.landmarks().collect::<Result<_, _>>()?,
            cross_covariances: self.cross_covariances().collect::<Result<_, _>>()?,
        };
        contents.sort();
        Ok(contents)
    }

    /// All of the map that can be read, and the errors of what cannot. Landmarks and cross-covariances that name
    /// an unreadable keyframe are left out, and so are observations in one, so the result satisfies the invariants of
    /// maps.
    ///
    /// # Errors
    /// Only where the map's info cannot be read, without which nothing else can be interpreted.
    fn read_readable(&self) -> Result<(MapContents, Vec<StoreError>), StoreError> {
        let mut errors = Vec::new();
        let mut contents = MapContents {
            info: self.info()?,
            keyframes: readable(self.keyframes(), &mut errors),
            landmarks: readable(self.landmarks(), &mut errors),
            cross_covariances: readable(self.cross_covariances(), &mut errors),
        };
        contents.sort();
        contents.drop_dangling();
        Ok((contents, errors))
    }
}

fn readable<T>(records: Records<'_, T>, errors: &mut Vec<StoreError>) -> Vec<T> {
    records.filter_map(|record| record.map_err(|error| errors.push(error)).ok()).collect()
}
