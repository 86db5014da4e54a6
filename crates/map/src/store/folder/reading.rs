//! Reading a map: a copy of its files in a temporary folder is verified and then opened.
//!
//! A database writes while it is opened and has only one user at a time. With a copy, a map on a read-only disk or of another
//! user is readable, any number of programs read it at once, and its database never sees bytes that were not written.

use std::fs::TryLockError;
use std::path::{Path, PathBuf};
use std::time::Duration;

use ::files::TemporaryFolder;

use super::files::{self, CopyError};
use super::manifest::Manifest;
use super::{Kind, is_of_former, kind_of};
use crate::contents::{ObservationCounts, RunningDigest};
use crate::store::error::{Damage, DatabaseError, StoreError};
use crate::store::guarded::{self, Unreturned};
use crate::store::map_store::{MapStore, OpenDatabase, ReadMap};
use crate::store::stored_landmarks::{LandmarkSource, StoredLandmarks};
use crate::store::stored_map::StoredMap;
use protocol::MapIdentity;

/// How often reading starts again because the map was replaced meanwhile.
const ATTEMPTS: usize = 5;
/// Time for reading a map that has no checksums: at least so long, ...
const MIN_READING_TIME: Duration = Duration::from_secs(10);
/// ... and so many bytes a second.
const MIN_BYTES_PER_SECOND: u64 = 2_000_000;

/// Reads the map in a folder.
pub(in crate::store) fn read(map: &Path, store: &'static dyn MapStore) -> Result<StoredMap, StoreError> {
    read_present(map, store, |manifest| read_version(map, manifest, store), Ok)
}

/// Opens the map in a folder: all but its landmarks, and these to be read one at a time.
pub(in crate::store) fn open(
    map: &Path,
    store: &'static dyn MapStore,
) -> Result<(StoredMap, StoredLandmarks), StoreError> {
    read_present(map, store, |manifest| open_version(map, manifest, store), |former| Ok(in_memory(former)))
}

/// Reads the map in a folder, in one way where it has checksums, and in another way where it has none.
fn read_present<T>(
    map: &Path,
    store: &'static dyn MapStore,
    of_version: impl Fn(&Manifest) -> Result<T, StoreError>,
    of_former: impl Fn(StoredMap) -> Result<T, StoreError>,
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
            Kind::Former => read_former(map, store).and_then(of_former),
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
    let read = read.map_err(|error| StoreError::unreadable(map, error))?;
    let as_written = is_as_written(manifest, &read) && read.contents.digest() == manifest.digest;
    if as_written { Ok(stored(map, read, manifest.bytes())) } else { Err(contents_damaged(map)) }
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
        let mut frame = database.read_frame()?;
        let summary = ReadSummary::take(database.as_ref(), &mut frame)?;
        Ok((database, frame, summary))
    });
    let (database, frame, summary) =
        opened.and_then(|result| result).map_err(|error| StoreError::unreadable(map, error))?;
    let source = LandmarkSource::Database { map: map.to_owned(), database, copy };
    let landmarks =
        StoredLandmarks { source, count: summary.count, observation_counts: summary.observation_counts };
    if is_as_written(manifest, &frame) && summary.digest == manifest.digest {
        Ok((stored(map, frame, manifest.bytes()), landmarks))
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
    /// Reads all landmarks once. Those that are damaged are added to the others of the map.
    fn take(database: &dyn OpenDatabase, frame: &mut ReadMap) -> Result<ReadSummary, DatabaseError> {
        let contents = &frame.contents;
        let mut counts = ObservationCounts::of(&contents.keyframes);
        let mut digest = RunningDigest::new(&contents.info);
        for keyframe in &contents.keyframes {
            digest.add_keyframe(keyframe);
        }
        let mut count = 0;
        let damaged = database.read_landmarks(&mut |landmark| {
            count += 1;
            digest.add_landmark(&landmark);
            counts.add(&landmark);
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
        frame.damaged.extend(damaged);
        Ok(ReadSummary { count, observation_counts: counts.finish(), digest: digest.finish() })
    }
}

/// The landmarks of a map of an older schema, which was read as a whole.
fn in_memory(mut former: StoredMap) -> (StoredMap, StoredLandmarks) {
    let landmarks = std::mem::take(&mut former.contents.landmarks);
    let mut counts = ObservationCounts::of(&former.contents.keyframes);
    for landmark in &landmarks {
        counts.add(landmark);
    }
    let count = landmarks.len();
    let source = LandmarkSource::Memory(landmarks);
    (former, StoredLandmarks { source, count, observation_counts: counts.finish() })
}

fn is_as_written(manifest: &Manifest, read: &ReadMap) -> bool {
    let info = &read.contents.info;
    info.version == manifest.version && info.identity == Some(manifest.identity) && read.damaged.is_empty()
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

/// Reads a map of schema 1 or 2: nothing says whether its files are those that were written.
fn read_former(map: &Path, store: &'static dyn MapStore) -> Result<StoredMap, StoreError> {
    let failed = |source| StoreError::Read { path: map.to_owned(), source };
    let mut names = files::list(map).map_err(failed)?;
    names.retain(|name| is_of_former(name.split('/').next().unwrap_or_default()));
    let mut bytes = 0;
    for name in &names {
        bytes += std::fs::metadata(map.join(name)).map_err(failed)?.len();
    }
    let copy = {
        // An older program that writes it holds this lock; locking changes nothing in the file.
        let database = ::files::open(map.join("db")).map_err(failed)?;
        if matches!(database.try_lock_shared(), Err(TryLockError::WouldBlock)) {
            return Err(StoreError::InUse { path: map.to_owned() });
        }
        let copy = TemporaryCopy::new(map, bytes)?;
        for name in &names {
            copy.add(map, name, name)?;
        }
        copy
    };
    let limit = MIN_READING_TIME + Duration::from_secs(bytes / MIN_BYTES_PER_SECOND);
    let folder = copy.folder.path().to_owned();
    let read = match guarded::call_within(limit, move || store.read(&folder)) {
        Ok(result) => result.map_err(|error| StoreError::unreadable(map, error))?,
        Err(Unreturned::Panicked(error)) => return Err(StoreError::unreadable(map, error)),
        Err(Unreturned::TimedOut) => {
            let damage = Damage::Endless { seconds: limit.as_secs() };
            return Err(StoreError::Damaged { path: map.to_owned(), damage });
        }
    };
    let mut stored = stored(map, read, bytes);
    // Always the same for the same records.
    stored.contents.info.identity = Some(stored.contents.digest());
    Ok(stored)
}

fn stored(map: &Path, read: ReadMap, bytes_on_disk: u64) -> StoredMap {
    let ReadMap { mut contents, damaged, schema } = read;
    if !damaged.is_empty() {
        contents.drop_dangling();
    }
    let corrupt = |(record, problem)| StoreError::Corrupt { path: map.to_owned(), record, problem };
    StoredMap { contents, damaged: damaged.into_iter().map(corrupt).collect(), schema, bytes_on_disk }
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
