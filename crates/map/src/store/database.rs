//! Reading and writing the map in a folder.

use std::path::Path;

use super::error::StoreError;
use super::folder;
use super::map_store::MapStore;
use super::sled_store::SledStore;
use super::stored_landmarks::StoredLandmarks;
use super::stored_map::{SavedMap, StoredMap};
use crate::contents::MapContents;

/// The database of all maps.
static STORE: &dyn MapStore = &SledStore;

/// Reads the map in a folder; nothing is written to it, and other programs may read or replace the map meanwhile.
///
/// Every byte is verified by checksums before it is used. Reading needs as much space in the temporary folder (`TMPDIR`) as
/// the map takes, and frees it before it returns.
///
/// # Errors
/// [`StoreError::Missing`], [`StoreError::NotAMap`], [`StoreError::Unfinished`], [`StoreError::Damaged`],
/// [`StoreError::Schema`], [`StoreError::Read`], [`StoreError::Copy`]; [`StoreError::InUse`] where it is replaced again and again.
pub fn load_map(path: impl AsRef<Path>) -> Result<StoredMap, StoreError> {
    folder::read(path.as_ref(), STORE)
}

/// Opens the map in a folder: all of it but the landmarks, and these to be read one at a time.
///
/// For those who keep landmarks in a form of their own: the whole map is never in memory twice. As with [`load_map`], all of
/// it is verified before this returns, and a copy in the temporary folder is freed when the landmarks were read.
///
/// # Errors
/// As [`load_map`].
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
/// let (stored, landmarks) = store::open_map(&path)?;
/// let mut count = 0;
/// landmarks.read(|_| count += 1)?;
/// assert_eq!((stored.contents.keyframes.len(), count), (0, 0));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn open_map(path: impl AsRef<Path>) -> Result<(StoredMap, StoredLandmarks), StoreError> {
    folder::open(path.as_ref(), STORE)
}

/// Writes a map into a new folder, or with `replace` in place of the map that is there. The new one then has the identity of
/// the former and a version that is one larger, so that robots which hold parts of it learn of the change. Both are set by
/// this function; those of `contents` are not used.
///
/// The map appears in one step once all of it is on the disk and was read back: whatever stops the program, and whatever
/// fails, the map that was there before remains. A folder with an unfinished map counts as free.
///
/// # Errors
/// [`StoreError::Invalid`] for a map that violates an invariant, [`StoreError::Exists`] without `replace`, and with it
/// [`StoreError::NotAMap`] where the path holds something else; [`StoreError::InUse`] where another program writes the map;
/// [`StoreError::Write`], for example of a full disk.
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
    contents.validate()?;
    let mut contents = contents.clone();
    contents.sort();
    folder::write(path, contents, replace, None, STORE)
}

/// Whether a folder holds a map, finished or not, whole or damaged.
pub fn is_map(path: &Path) -> bool {
    folder::is_map(path)
}

/// Ensures that [`save_map`] would not write over something that must stay: to be asked before a map is built.
///
/// # Errors
/// [`StoreError::Exists`] without `replace`, and with it [`StoreError::NotAMap`]; [`StoreError::Read`].
pub fn ensure_free(path: &Path, replace: bool) -> Result<(), StoreError> {
    folder::ensure_free(path, replace)
}
