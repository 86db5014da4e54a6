//! Reading a map: a copy of its files in a temporary folder is verified and then opened.
//!
//! A database writes while it is opened and has only one user at a time. With a copy, a map on a read-only disk or of another
//! user is readable, any number of programs read it at once, and its database never sees bytes that were not written.

use std::path::{Path, PathBuf};

use ::files::TemporaryFolder;

use super::files::{self, CopyError};
use super::manifest::Manifest;
use super::{Kind, kind_of};
use crate::contents::{MapContents, ObservationCounts, RunningDigest};
use crate::store::error::{Damage, DatabaseError, StoreError};
use crate::store::guarded;
use crate::store::map_store::{MapStore, OpenDatabase};
use crate::store::record::{self, LandmarkObservers};
use crate::store::stored_landmarks::StoredLandmarks;
use crate::store::stored_map::StoredMap;
use protocol::MapIdentity;

/// How often reading starts again because the map was replaced meanwhile.
const ATTEMPTS: usize = 5;

/// Reads the map in a folder.
pub(in crate::store) fn read(map: &Path, store: &'static dyn MapStore) -> Result<StoredMap, StoreError> {
    read_present(map, |manifest| read_version(map, manifest, store))
}

/// Opens the map in a folder: all but its landmarks, and these to be read one at a time.
pub(in crate::store) fn open(
    map: &Path,
    store: &'static dyn MapStore,
) -> Result<(StoredMap, StoredLandmarks), StoreError> {
    read_present(map, |manifest| open_version(map, manifest, store))
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
    Manifest::read(map).is_ok_and(|present| present != *manifest)
}

/// Reads the version that a manifest names.
pub(super) fn read_version(
    map: &Path,
    manifest: &Manifest,
    store: &dyn MapStore,
) -> Result<StoredMap, StoreError> {
    let copy = verified_copy(map, manifest)?;
    let read = guarded::call(|| store.read(copy.folder.path())).and_then(|result| result);
    let contents = read.map_err(|error| StoreError::unreadable(map, error))?;
    if is_as_written(manifest, &contents) && contents.digest() == manifest.digest {
        Ok(StoredMap { contents, bytes_on_disk: manifest.bytes() })
    } else {
        Err(contents_damaged(map))
    }
}

/// Opens the version that a manifest names, and reads all of it once to verify it.
pub(super) fn open_version(
    map: &Path,
    manifest: &Manifest,
    store: &dyn MapStore,
) -> Result<(StoredMap, StoredLandmarks), StoreError> {
    let copy = verified_copy(map, manifest)?;
    let opened = guarded::call(|| {
        let database = store.open(copy.folder.path())?;
        let contents = database.read_frame()?;
        let summary = ReadSummary::take(database.as_ref(), &contents)?;
        Ok((database, contents, summary))
    });
    let (database, contents, summary) =
        opened.and_then(|result| result).map_err(|error| StoreError::unreadable(map, error))?;
    let ReadSummary { count, observation_counts, digest } = summary;
    let landmarks = StoredLandmarks { map: map.to_owned(), database, copy, count, observation_counts };
    if is_as_written(manifest, &contents) && digest == manifest.digest {
        Ok((StoredMap { contents, bytes_on_disk: manifest.bytes() }, landmarks))
    } else {
        landmarks.close()?;
        Err(contents_damaged(map))
    }
}

/// What the landmarks of a database amount to.
struct ReadSummary {
    count: usize,
    /// By keyframe.
    observation_counts: Vec<u32>,
    /// Of the whole map.
    digest: MapIdentity,
}

impl ReadSummary {
    /// Reads all landmarks once.
    ///
    /// # Arguments
    /// * `contents`: the map without its landmarks.
    fn take(database: &dyn OpenDatabase, contents: &MapContents) -> Result<ReadSummary, DatabaseError> {
        let mut counts = ObservationCounts::of(&contents.keyframes);
        let mut digest = RunningDigest::new(&contents.info);
        for keyframe in &contents.keyframes {
            digest.add_keyframe(keyframe);
        }
        let mut count = 0;
        database.visit_landmarks(&mut |id, payload| {
            count += 1;
            digest.add_landmark_record(id, payload);
            counts.add_observers(record::decode::<LandmarkObservers>(payload)?.keyframes());
            Ok(())
        })?;
        for cross in &contents.cross_covariances {
            digest.add_cross_covariance(cross);
        }
        for common in &contents.common_errors {
            digest.add_common_error(common);
        }
        for aliases in &contents.aliases {
            digest.add_aliases(aliases);
        }
        Ok(ReadSummary { count, observation_counts: counts.finish(), digest: digest.finish() })
    }
}

fn is_as_written(manifest: &Manifest, contents: &MapContents) -> bool {
    let info = &contents.info;
    info.version == manifest.version && info.identity == Some(manifest.identity)
}

fn contents_damaged(map: &Path) -> StoreError {
    StoreError::Damaged { path: map.to_owned(), damage: Damage::Contents }
}

/// A copy of the files of the version that a manifest names, with the checksums that it states.
fn verified_copy(map: &Path, manifest: &Manifest) -> Result<TemporaryCopy, StoreError> {
    let damaged = |damage| StoreError::Damaged { path: map.to_owned(), damage };
    let copy = TemporaryCopy::new(map, manifest.bytes())?;
    let version = map.join(&manifest.folder);
    for file in &manifest.files {
        let name = format!("{}/{}", manifest.folder, file.path);
        let (bytes, sha256) = copy.add(&version, &file.path, &name)?;
        if bytes != file.bytes {
            return Err(damaged(Damage::Length { file: name, found: bytes, expected: file.bytes }));
        }
        if sha256 != file.sha256 {
            return Err(damaged(Damage::Checksum { file: name }));
        }
    }
    Ok(copy)
}

/// A copy of a map's files that is removed when it is dropped.
pub(in crate::store) struct TemporaryCopy {
    map: PathBuf,
    folder: TemporaryFolder,
    /// Of all files together.
    bytes: u64,
}

impl TemporaryCopy {
    fn new(map: &Path, bytes: u64) -> Result<TemporaryCopy, StoreError> {
        let parent = std::env::temp_dir();
        let folder = TemporaryFolder::new_in(&parent);
        let failed =
            |source| StoreError::Copy { path: map.to_owned(), folder: parent.clone(), bytes, source };
        let copy = TemporaryCopy { map: map.to_owned(), folder: folder.map_err(failed)?, bytes };
        tracing::info!(
            map = %map.display(),
            copy = %copy.folder.path().display(),
            bytes,
            "reading a copy of the database; the original is not opened"
        );
        Ok(copy)
    }

    /// Copies the file at `path` in `from`, which is called `name` in messages; its bytes and its SHA-256.
    fn add(&self, from: &Path, path: &str, name: &str) -> Result<(u64, String), StoreError> {
        let source = from.join(path);
        files::copy(&source, self.folder.path(), path).map_err(|error| match error {
            CopyError::Read(error) if error.kind() == std::io::ErrorKind::NotFound => {
                let damage = Damage::MissingFile { file: name.to_owned() };
                StoreError::Damaged { path: self.map.clone(), damage }
            }
            CopyError::Read(error) => StoreError::Read { path: source, source: error },
            CopyError::Write(error) => StoreError::Copy {
                path: self.map.clone(),
                folder: self.folder.path().to_owned(),
                bytes: self.bytes,
                source: error,
            },
        })
    }
}
