//! Creating, opening and replacing the database of a map.

use std::path::Path;

use super::error::StoreError;
use super::map_store::MapStore;
use super::sled_store::SledStore;
use crate::contents::MapContents;
use crate::model::MapMetadata;

/// Creates a new map without keyframes, of version 0.
///
/// # Arguments
/// * `path`: a directory that does not exist yet, or is empty.
///
/// # Errors
/// [`StoreError::Exists`], [`StoreError::Invalid`] for impossible `info`, [`StoreError::Database`].
pub fn create(path: impl AsRef<Path>, info: &MapMetadata) -> Result<Box<dyn MapStore>, StoreError> {
    Ok(Box::new(SledStore::create(path.as_ref(), info)?))
}

/// Opens the map in a directory.
///
/// # Errors
/// [`StoreError::Missing`], [`StoreError::NotAMap`], [`StoreError::Schema`], [`StoreError::InUse`],
/// [`StoreError::Database`].
pub fn open(path: impl AsRef<Path>) -> Result<Box<dyn MapStore>, StoreError> {
    Ok(Box::new(SledStore::open(path.as_ref())?))
}

/// Writes a map into a new database, or with `replace` over the map that is there, whose version then grows by one, so
/// that robots which hold parts of it learn of the change.
///
/// # Returns
/// The version of the map.
///
/// # Errors
/// [`StoreError::Invalid`] for a map that violates an invariant (nothing is written then), [`StoreError::Exists`]
/// without `replace`, and with it [`StoreError::NotAMap`] where the path holds something else; [`StoreError::Database`].
///
/// # Example
/// ```
/// use map::{MapContents, MapMetadata, MapStore as _, store};
/// use protocol::DescriptorKind;
///
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("hall.db");
/// let contents = MapContents::empty(MapMetadata::new("hall", "example", DescriptorKind::Binary, 32));
/// assert_eq!(store::save_map(&path, &contents, false)?, 1);
/// assert_eq!(store::save_map(&path, &contents, true)?, 2);
/// assert_eq!(store::open(&path)?.read_contents()?.info.name, "hall");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn save_map(path: &Path, contents: &MapContents, replace: bool) -> Result<u64, StoreError> {
    contents.validate()?;
    let empty = || std::fs::read_dir(path).is_ok_and(|mut entries| entries.next().is_none());
    let store =
        if replace && path.exists() && !empty() { open(path)? } else { create(path, &contents.info)? };
    store.replace_all(contents)
}
