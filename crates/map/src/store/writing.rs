//! Writing a map: beside the present one, and made the map in one step.

use std::fs::{File, TryLockError};
use std::io::{ErrorKind, Write as _};
use std::path::{Path, PathBuf};

use super::error::{StoreError, WriteProblem};
use super::folder::{
    Kind, LOCK, MANIFEST, MAX_MANIFEST_BYTES, Seen, ensure_free, entries, file_of, kind_of, version_of,
};
use super::stored_map::SavedMap;
use crate::contents::{MapContents, RunningDigest, Sorted};
use crate::file::manifest::{AddedSegments, Manifest};
use crate::file::record::Element;
use crate::file::segment::{Layout, OF_IMAGES, OF_MAP_WITH_EXISTENCE, SegmentName, SegmentWriter};
use crate::model::MapMetadata;
use protocol::MapIdentity;

/// A segment is cut where its records have so many bytes: whoever reads a map has one in memory beside what it was read into.
const SEGMENT_BYTES: usize = 16 << 20;
/// The same of images: whoever wants one reads its segment.
const IMAGE_SEGMENT_BYTES: usize = 1 << 20;

/// Writes a valid map into a folder, see [`super::save_map`].
///
/// # Arguments
/// * `seen`: what must still be there.
/// * `numbering`: which version and identity it gets.
pub(super) fn write(
    map: &Path,
    contents: &MapContents,
    replace: bool,
    seen: &Seen,
    numbering: Numbering,
) -> Result<SavedMap, StoreError> {
    let failed = |problem| StoreError::Write { path: map.to_owned(), problem };
    ensure_free(map, replace)?;
    let is_new = !map.exists();
    std::fs::create_dir_all(map).map_err(|source| failed(of_file(map, source)))?;
    if let Some(parent) = map.parent().filter(|parent| is_new && !parent.as_os_str().is_empty()) {
        sync_folder(parent).map_err(failed)?;
    }
    let _lock = Lock::take(map)?;
    // Another program may have completed a map until the lock was free.
    ensure_free(map, replace)?;
    let found = Seen::at(map)?;
    if *seen != found {
        let (seen, found) = (seen.version(), found.version());
        return Err(StoreError::Changed { path: map.to_owned(), seen, found });
    }

    let present = Present::of(map);
    let (version, identity) = match numbering {
        Numbering::Own => (present.version + 1, present.identity),
        Numbering::OfContents => (contents.info.version.max(present.version + 1), contents.info.identity),
    };
    let path = map.join(file_of(version));
    let written = write_version(map, &path, contents, version, identity);
    // What it left is no map, and is replaced by the next one that is written.
    let saved = written.inspect_err(|_| _ = std::fs::remove_file(&path)).map_err(failed)?;
    remove_all_but(map, version);
    Ok(saved)
}

/// Which version and identity a map gets that is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Numbering {
    /// The next version of the map that is there, with its identity.
    Own,
    /// Those of the contents; a version beyond that of the map that is there.
    OfContents,
}

/// The map that is replaced.
struct Present {
    /// 0 where there is none.
    version: u64,
    /// `None`: there is no map, or its identity cannot be read.
    identity: Option<MapIdentity>,
}

impl Present {
    fn of(map: &Path) -> Present {
        match kind_of(map) {
            Ok(Kind::Complete(manifest)) => {
                Present { version: manifest.map.version, identity: manifest.map.identity }
            }
            // The number of a version must not come again: robots would take the new map for the old one.
            Err(StoreError::Damaged { .. }) => {
                let names = entries(map).unwrap_or_default();
                let newest = names.iter().filter_map(|name| version_of(name)).max();
                Present { version: newest.unwrap_or(0).min(u64::MAX - 2), identity: None }
            }
            _ => Present { version: 0, identity: None },
        }
    }
}

/// Writes the segments, and when they are on the disk the manifest.
fn write_version(
    map: &Path,
    path: &Path,
    contents: &MapContents,
    version: u64,
    identity: Option<MapIdentity>,
) -> Result<SavedMap, WriteProblem> {
    let sorted = Sorted::of(contents);
    let mut writer = VersionWriter::create(path, &contents.info)?;
    sorted.keyframes.iter().try_for_each(|keyframe| writer.add(*keyframe))?;
    sorted.cross_covariances.iter().try_for_each(|cross| writer.add(cross.as_ref()))?;
    sorted.common_errors.iter().try_for_each(|common| writer.add(*common))?;
    sorted.aliases.iter().try_for_each(|aliases| writer.add(*aliases))?;
    sorted.existence.iter().try_for_each(|existence| writer.add(*existence))?;
    let frame = writer.take_segments()?;
    sorted.landmarks.iter().try_for_each(|landmark| writer.add(landmark.as_ref()))?;
    let landmarks = writer.take_segments()?;
    let mut added_features = Vec::with_capacity(sorted.added_features.len());
    for (kind, of_kind) in &sorted.added_features {
        writer.digest.add_kind(kind);
        of_kind.iter().try_for_each(|landmark| writer.add(landmark.as_ref()))?;
        added_features.push(AddedSegments { kind: (*kind).clone(), landmarks: writer.take_segments()? });
    }
    writer.begin(OF_IMAGES, IMAGE_SEGMENT_BYTES);
    sorted.images.iter().try_for_each(|image| writer.add(*image))?;
    let images = writer.take_segments()?;
    let digest = writer.finish()?;
    sync_folder(map)?;
    let identity = identity.unwrap_or(digest);
    let sessions = contents.sessions_to_store();
    let info = MapMetadata { version, identity: Some(identity), sessions, ..contents.info.clone() };
    let manifest = Manifest { map: info, digest, frame, landmarks, added_features, images };
    let file = map.join(MANIFEST);
    let text = manifest.encode().map_err(|error| of_file(&file, error.into()))?;
    ensure_readable(text.len() as u64, manifest.map.sessions.len())?;
    files::write_whole(&file, &text).map_err(|source| WriteProblem::File { file, source })?;
    Ok(SavedMap { version, identity })
}

/// Checks that a manifest can be read again: as soon as it has its name, the version before it is removed.
fn ensure_readable(bytes: u64, sessions: usize) -> Result<(), WriteProblem> {
    let most = MAX_MANIFEST_BYTES;
    if bytes > most { Err(WriteProblem::LongLedger { sessions, bytes, most }) } else { Ok(()) }
}

/// The file of a version while it is written.
struct VersionWriter {
    path: PathBuf,
    file: File,
    /// The one that is being made.
    segment: SegmentWriter,
    /// What they are segments of, and their size.
    layout: &'static Layout,
    most_bytes: usize,
    /// Those that were written.
    segments: Vec<SegmentName>,
    digest: RunningDigest,
}

impl VersionWriter {
    fn create(path: &Path, info: &MapMetadata) -> Result<VersionWriter, WriteProblem> {
        // A file of that name was left by a program that was stopped.
        let removed = match std::fs::remove_file(path) {
            Err(error) if error.kind() != ErrorKind::NotFound => Err(error),
            _ => Ok(()),
        };
        let created = removed.and_then(|()| File::create_new(path));
        Ok(VersionWriter {
            path: path.to_owned(),
            file: created.map_err(|source| of_file(path, source))?,
            segment: SegmentWriter::new(OF_MAP_WITH_EXISTENCE),
            layout: OF_MAP_WITH_EXISTENCE,
            most_bytes: SEGMENT_BYTES,
            segments: Vec::new(),
            digest: RunningDigest::new(info),
        })
    }

    /// Goes on with segments of another kind, after [`VersionWriter::take_segments`].
    fn begin(&mut self, layout: &'static Layout, most_bytes: usize) {
        (self.segment, self.layout, self.most_bytes) = (SegmentWriter::new(layout), layout, most_bytes);
    }

    fn add<E: Element>(&mut self, element: &E) -> Result<(), WriteProblem> {
        let payload = self.segment.add(element).map_err(WriteProblem::Record)?;
        self.digest.add_record::<E>(element.key(), payload);
        if self.segment.bytes() >= self.most_bytes { self.end_segment() } else { Ok(()) }
    }

    fn end_segment(&mut self) -> Result<(), WriteProblem> {
        let bytes = std::mem::replace(&mut self.segment, SegmentWriter::new(self.layout)).finish();
        self.file.write_all(&bytes).map_err(|source| of_file(&self.path, source))?;
        self.segments.push(SegmentName::of(&bytes));
        Ok(())
    }

    /// Ends the present segment, and names those since the last call.
    fn take_segments(&mut self) -> Result<Vec<SegmentName>, WriteProblem> {
        if self.segment.bytes() > 0 {
            self.end_segment()?;
        }
        Ok(std::mem::take(&mut self.segments))
    }

    /// Waits until all of it is on the disk.
    ///
    /// # Returns
    /// The digest of the map.
    fn finish(self) -> Result<MapIdentity, WriteProblem> {
        self.file.sync_all().map_err(|source| of_file(&self.path, source))?;
        Ok(self.digest.finish())
    }
}

fn of_file(file: &Path, source: std::io::Error) -> WriteProblem {
    WriteProblem::File { file: file.to_owned(), source }
}

/// Waits until the names in a folder are on the disk.
fn sync_folder(folder: &Path) -> Result<(), WriteProblem> {
    let synced = if cfg!(unix) { File::open(folder).and_then(|folder| folder.sync_all()) } else { Ok(()) };
    synced.map_err(|source| of_file(folder, source))
}

/// Removes other versions. What cannot be removed takes space until the next version.
fn remove_all_but(map: &Path, version: u64) {
    for name in entries(map).unwrap_or_default() {
        if version_of(&name).is_none_or(|other| other == version) {
            continue;
        }
        let path = map.join(&name);
        if let Err(error) = std::fs::remove_file(&path) {
            tracing::warn!(path = %path.display(), "a former version of the map was not removed: {error}");
        }
    }
}

/// Lets one program at a time write a map; released when it is dropped, and when the program ends.
struct Lock {
    file: File,
}

impl Drop for Lock {
    fn drop(&mut self) {
        // Closing is not enough: a child process that was just started has the file open until it runs its program.
        let _ = self.file.unlock();
    }
}

impl Lock {
    fn take(map: &Path) -> Result<Lock, StoreError> {
        let path = map.join(LOCK);
        let failed = |source| StoreError::Write { path: map.to_owned(), problem: of_file(&path, source) };
        let file = File::options().create(true).truncate(false).write(true).open(&path).map_err(failed)?;
        match file.try_lock() {
            Ok(()) => Ok(Lock { file }),
            Err(TryLockError::WouldBlock) => Err(StoreError::InUse { path: map.to_owned() }),
            Err(TryLockError::Error(source)) => Err(failed(source)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lock_that_a_child_process_has_open_is_free_once_it_is_released() {
        let map = tempfile::tempdir().unwrap();
        let lock = Lock::take(map.path()).unwrap();
        assert!(matches!(Lock::take(map.path()), Err(StoreError::InUse { .. })));
        let of_child = lock.file.try_clone().unwrap();
        drop(lock);
        Lock::take(map.path()).unwrap();
        drop(of_child);
    }
}
