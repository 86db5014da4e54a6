//! Reading a map. Every byte is verified once, before anything of it is used.

use std::path::Path;

use super::error::StoreError;
use super::folder::{Kind, kind_of, read_manifest};
use super::stored_landmarks::{LandmarkCounts, StoredLandmarks, decode_landmark};
use super::stored_map::StoredMap;
use super::version_file::VersionFile;
use crate::added::KeptImage;
use crate::contents::{MapContents, ObservationCounts};
use crate::file::manifest::Manifest;
use crate::file::record::{Element as _, LandmarkObservers, decode};

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
        for (added, landmarks) in kinds(manifest).zip(contents.landmarks_of_kinds_mut()) {
            file.visit_landmarks(added, true, |id, payload| {
                landmarks.push(decode_landmark(id, payload)?);
                Ok(())
            })?;
            landmarks.shrink_to_fit();
        }
        file.visit_images(|keyframe, payload| {
            contents.images.push(KeptImage::from_record([keyframe], decode(payload)?)?);
            Ok(())
        })?;
        Ok(stored(manifest, contents))
    })
}

/// Opens the map in a folder: all of it but the landmarks, and these to be read one at a time. The images of keyframes are left
/// out; [`StoredImages`](super::StoredImages) reads them.
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
/// let (stored, mut landmarks) = store::open_map(&path)?;
/// let mut count = 0;
/// landmarks.read(0, |_| count += 1)?;
/// assert_eq!((stored.contents.keyframes.len(), count), (0, 0));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn open_map(path: impl AsRef<Path>) -> Result<(StoredMap, StoredLandmarks), StoreError> {
    let path = path.as_ref();
    read_present(path, |manifest| {
        let mut file = VersionFile::open(path, manifest)?;
        let contents = file.read_frame()?;
        let mut counted = Vec::with_capacity(1 + contents.added_features.len());
        for added in kinds(manifest) {
            let (mut count, mut counts) = (0, ObservationCounts::of(&contents.keyframes));
            file.visit_landmarks(added, true, |_, payload| {
                count += 1;
                counts.add_observers(decode::<LandmarkObservers>(payload)?.keyframes());
                Ok(())
            })?;
            counted.push(LandmarkCounts { landmarks: count, observations: counts.finish() });
        }
        file.visit_images(|_, _| Ok(()))?;
        let landmarks = StoredLandmarks { file, counted };
        Ok((stored(manifest, contents), landmarks))
    })
}

fn stored(manifest: &Manifest, contents: MapContents) -> StoredMap {
    let (digest, bytes_on_disk, schema) = (manifest.digest, manifest.bytes(), manifest.schema());
    StoredMap { contents, digest, bytes_on_disk, schema }
}

/// The kinds of features of a map, as [`VersionFile::visit_landmarks`] takes them.
fn kinds(manifest: &Manifest) -> impl Iterator<Item = Option<usize>> {
    std::iter::once(None).chain((0..manifest.added_features.len()).map(Some))
}

/// Reads the version that the manifest in a folder names, again where it was replaced meanwhile.
pub(super) fn read_present<T>(
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
