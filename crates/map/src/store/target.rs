//! Where a map is to be written, and what was there when the work on it began.

use std::path::{Path, PathBuf};

use super::error::StoreError;
use super::folder::{self, Seen};
use super::sled_store::SledStore;
use super::stored_map::SavedMap;
use crate::contents::MapContents;

/// Where a map is to be written, and what was there when the work on it began.
///
/// Building and editing take a while. What another program writes to the same place meanwhile is not overwritten: the
/// result was made of, or in the place of, another version.
///
/// # Example
/// ```
/// use map::{MapContents, MapMetadata, store};
/// use protocol::DescriptorKind;
///
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("hall.db");
/// let contents = MapContents::empty(MapMetadata::new("hall", "example", DescriptorKind::Binary, 32));
/// store::save_map(&path, &contents, false)?;
///
/// let (one, other) = (store::MapTarget::new(&path, true)?, store::MapTarget::new(&path, true)?);
/// assert_eq!(one.save(&contents)?.version, 2);
/// let refused = other.save(&contents).unwrap_err();
/// assert!(matches!(refused, store::StoreError::Changed { .. }), "{refused}");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct MapTarget {
    path: PathBuf,
    replace: bool,
    seen: Seen,
}

impl MapTarget {
    /// Looks at what is there: to be called before anything is read or built.
    ///
    /// # Errors
    /// As of [`ensure_free`](super::ensure_free).
    pub fn new(path: &Path, replace: bool) -> Result<MapTarget, StoreError> {
        let seen = Seen::at(path)?;
        folder::ensure_free(path, replace)?;
        Ok(MapTarget { path: path.to_owned(), replace, seen })
    }

    /// Where.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Writes a map, as [`save_map`](super::save_map) does.
    ///
    /// # Errors
    /// Those of [`save_map`](super::save_map); [`StoreError::Changed`] where another version was written since.
    pub fn save(&self, contents: &MapContents) -> Result<SavedMap, StoreError> {
        contents.validate()?;
        let mut contents = contents.clone();
        contents.sort();
        folder::write(&self.path, contents, self.replace, Some(&self.seen), &SledStore)
    }
}
