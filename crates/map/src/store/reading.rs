//! Reading a map. Every byte is verified once, before anything of it is used.

use std::path::Path;

use super::error::StoreError;
use super::folder::{Kind, kind_of, read_manifest};
use super::stored_landmarks::{StoredLandmarks, decode_landmark};
use super::stored_map::StoredMap;
use super::version_file::VersionFile;
use crate::contents::ObservationCounts;
use crate::file::manifest::Manifest;
use crate::file::record::{LandmarkObservers, decode};

/// How often reading starts again because the map was replaced meanwhile.
const ATTEMPTS: usize = 5;

/// Reads the map in a folder; nothing is written to it, and other programs may read or replace the map meanwhile.
///
/// Every byte is verified by checksums before it is used.
///
/// # Errors
/// [`StoreError::Missing`], [`StoreError::NotAMap`], [`StoreError::Unfinished`], [`StoreError::Damaged`],
/// [`StoreError::Schema`], [`StoreError::Read`]; [`StoreError::InUse`] where it is replaced again and again.
pub fn load_map(path: impl AsRef<Path>) -> Result<StoredMap, StoreError> {
    let path = path.as_ref();
    read_present(path, |manifest| {
        let mut file = VersionFile::open(path, manifest)?;
        let mut contents = file.read_frame()?;
        file.visit_landmarks(true, |id, payload| {
            contents.landmarks.push(decode_landmark(id, payload)?);
            Ok(())
        })?;
        contents.landmarks.shrink_to_fit();
        Ok(StoredMap { contents, bytes_on_disk: manifest.bytes() })
    })
}

/// Opens the map in a folder: all of it but the landmarks, and these to be read one at a time.
///
/// For those who keep landmarks in a form of their own: the whole map is never in memory twice. As with [`load_map`], all of
/// it is verified before this returns.
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
    let path = path.as_ref();
    read_present(path, |manifest| {
        let mut file = VersionFile::open(path, manifest)?;
        let contents = file.read_frame()?;
        let mut counts = ObservationCounts::of(&contents.keyframes);
        let mut count = 0;
        file.visit_landmarks(true, |_, payload| {
            count += 1;
            counts.add_observers(decode::<LandmarkObservers>(payload)?.keyframes());
            Ok(())
        })?;
        let landmarks = StoredLandmarks { file, count, observation_counts: counts.finish() };
        Ok((StoredMap { contents, bytes_on_disk: manifest.bytes() }, landmarks))
    })
}

/// Reads the version that the manifest in a folder names, again where it was replaced meanwhile.
fn read_present<T>(
    map: &Path,
    of_version: impl Fn(&Manifest) -> Result<T, StoreError>,
) -> Result<T, StoreError> {
    let path = || map.to_owned();
    for _ in 0..ATTEMPTS {
        return match kind_of(map)? {
            Kind::Missing => Err(StoreError::Missing { path: path() }),
            Kind::Empty => Err(StoreError::NotAMap {
                path: path(),
                problem: "the folder is empty; build one with `driftless build-map` or `driftless import-map`",
            }),
            Kind::Unfinished => Err(StoreError::Unfinished { path: path() }),
            Kind::Other(problem) => Err(StoreError::NotAMap { path: path(), problem }),
            Kind::Complete(manifest) => match of_version(&manifest) {
                Err(_) if was_replaced(map, &manifest) => continue,
                result => result,
            },
        };
    }
    Err(StoreError::InUse { path: path() })
}

fn was_replaced(map: &Path, manifest: &Manifest) -> bool {
    read_manifest(map).is_ok_and(|present| present != *manifest)
}
