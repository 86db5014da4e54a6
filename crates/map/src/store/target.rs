//! Where a map is to be written, and what was there when the work on it began.

use std::path::{Path, PathBuf};

use super::error::StoreError;
use super::folder::{Seen, ensure_free};
use super::stored_map::SavedMap;
use super::writing::{self, Numbering};
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
///
/// let mut long_work = store::MapTarget::new(&path, true)?;
/// assert_eq!(long_work.save_next(&contents)?.version, 3);
/// assert_eq!(long_work.save_next(&contents)?.version, 4);
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
        ensure_free(path, replace)?;
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
        writing::write(&self.path, contents, self.replace, &self.seen, Numbering::Own)
    }

    /// Writes a map as [`MapTarget::save`] does, in place of the version that this value saved before: work that lasts for long saves what it
    /// has so far.
    ///
    /// # Errors
    /// As of [`MapTarget::save`].
    pub fn save_next(&mut self, contents: &MapContents) -> Result<SavedMap, StoreError> {
        let saved = self.save(contents)?;
        let seen = Seen::at(&self.path)?;
        if seen.version() != saved.version {
            let (seen, found) = (saved.version, seen.version());
            return Err(StoreError::Changed { path: self.path.clone(), seen, found });
        }
        (self.seen, self.replace) = (seen, true);
        Ok(saved)
    }

    /// Writes a copy of a map that has its identity and its versions elsewhere, as of a release: with that identity, and a version
    /// that is not less than either map's. What is there must be a version of the same map, or nothing.
    ///
    /// # Errors
    /// As of [`MapTarget::save`]; [`StoreError::OtherMap`] where another map is there, or the copied one states no identity.
    pub fn save_copy(&self, contents: &MapContents) -> Result<SavedMap, StoreError> {
        contents.validate()?;
        let given = contents.info.identity;
        let found = self.seen.identity();
        if given.is_none() || found.is_some() && found != given {
            return Err(StoreError::OtherMap { path: self.path.clone(), found, given });
        }
        writing::write(&self.path, contents, self.replace, &self.seen, Numbering::OfContents)
    }
}

/// Writes a map into a new folder, or with `replace` in place of the map that is there. The new one then has the identity of
/// the former and a version that is one larger, so that robots which hold parts of it learn of the change. Both are set by
/// this function; those of `contents` are not used.
///
/// The map appears in one step once all of it is on the disk: whatever stops the program, and whatever fails, the map that was
/// there before remains. A folder with an unfinished map counts as free.
///
/// # Errors
/// [`StoreError::Invalid`] for a map that violates an invariant, [`StoreError::Exists`] without `replace`, and with it
/// [`StoreError::NotAMap`] where the path holds something else; [`StoreError::InUse`], [`StoreError::Changed`] where another
/// program writes the map; [`StoreError::Write`], for example of a full disk.
///
/// # Example
/// ```
/// use map::{MapContents, MapMetadata, store};
/// use protocol::DescriptorKind;
///
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("hall.db");
/// let contents = MapContents::empty(MapMetadata::new("hall", "example", DescriptorKind::Binary, 32));
/// let first = store::save_map(&path, &contents, false)?;
/// let second = store::save_map(&path, &contents, true)?;
/// assert_eq!((first.version, second.version), (1, 2));
/// assert_eq!(first.identity, second.identity);
/// assert_eq!(store::load_map(&path)?.contents.info.name, "hall");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn save_map(path: &Path, contents: &MapContents, replace: bool) -> Result<SavedMap, StoreError> {
    MapTarget::new(path, replace)?.save(contents)
}
