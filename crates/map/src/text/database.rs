//! Putting a map that was made in memory into its database.

use std::path::Path;

use crate::contents::MapContents;
use crate::store::{MapStore, SledStore, StoreError};

/// Writes a map into a new database, or with `replace` over the map that is there, whose version then grows, so that
/// robots which hold parts of it learn of the change.
///
/// # Returns
/// The version of the map.
///
/// # Errors
/// [`StoreError::Invalid`] for a map that breaks a law (nothing is written then), [`StoreError::Exists`] without
/// `replace`, and with it [`StoreError::NotAMap`] where something else is in the place; [`StoreError::Database`].
pub fn save_map(path: &Path, contents: &MapContents, replace: bool) -> Result<u64, StoreError> {
    contents.validate()?;
    let empty = || std::fs::read_dir(path).is_ok_and(|mut entries| entries.next().is_none());
    let store = if replace && path.exists() && !empty() {
        SledStore::open(path)?
    } else {
        SledStore::create(path, &contents.info)?
    };
    store.replace_all(contents)
}
