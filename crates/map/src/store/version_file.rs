//! The segments of one version, open for reading.

use std::fs::File;
use std::io::{ErrorKind, Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};

use protocol::LandmarkId;

use super::error::{Damage, StoreError};
use super::folder::file_of;
use crate::contents::MapContents;
use crate::file::manifest::Manifest;
use crate::file::record::{Element, RecordError};
use crate::file::segment::{self, Segment, SegmentError, SegmentName};

/// The open file of a version. It can be read to its end when the map has been replaced meanwhile.
pub(super) struct VersionFile {
    map: PathBuf,
    /// Its name in the folder of the map.
    name: String,
    file: File,
    /// What is in it.
    manifest: Manifest,
}

impl VersionFile {
    /// Opens the file of the version that a manifest states.
    pub(super) fn open(map: &Path, manifest: &Manifest) -> Result<VersionFile, StoreError> {
        let name = file_of(manifest.map.version);
        let path = map.join(&name);
        let damaged = |damage| StoreError::Damaged { path: map.to_owned(), damage };
        let failed = |source| StoreError::Read { path: path.clone(), source };
        let file = files::open(&path).map_err(|error| match error.kind() {
            ErrorKind::NotFound => damaged(Damage::MissingFile { file: name.clone() }),
            _ => failed(error),
        })?;
        let (found, expected) = (file.metadata().map_err(failed)?.len(), manifest.bytes());
        if found != expected {
            return Err(damaged(Damage::Length { file: name, found, expected }));
        }
        Ok(VersionFile { map: map.to_owned(), name, file, manifest: manifest.clone() })
    }

    /// Reads all but the landmarks.
    pub(super) fn read_frame(&mut self) -> Result<MapContents, StoreError> {
        let mut contents = MapContents::empty(self.manifest.map.clone());
        self.visit_segments(0, &self.manifest.frame.clone(), true, |bytes| {
            let Segment { keyframes, cross_covariances, common_errors, aliases, .. } =
                Segment::decode_frame(bytes)?;
            append(&mut contents.keyframes, keyframes)?;
            append(&mut contents.cross_covariances, cross_covariances)?;
            append(&mut contents.common_errors, common_errors)?;
            append(&mut contents.aliases, aliases)
        })?;
        Ok(contents)
    }

    /// Visits the payloads of the landmarks' records by id.
    ///
    /// # Arguments
    /// * `verify`: whether each segment must have its SHA-256, as the first time that it is read.
    pub(super) fn visit_landmarks(
        &mut self,
        verify: bool,
        mut visit: impl FnMut(LandmarkId, &[u8]) -> Result<(), RecordError>,
    ) -> Result<(), StoreError> {
        let start = self.manifest.frame.iter().map(|segment| segment.bytes).sum();
        let mut previous = None;
        self.visit_segments(start, &self.manifest.landmarks.clone(), verify, |bytes| {
            previous = segment::visit_landmarks(bytes, previous, &mut visit)?;
            Ok(())
        })
    }

    /// Visits the bytes of segments that follow each other from `at` on.
    fn visit_segments(
        &mut self,
        mut at: u64,
        segments: &[SegmentName],
        verify: bool,
        mut visit: impl FnMut(&[u8]) -> Result<(), SegmentError>,
    ) -> Result<(), StoreError> {
        let mut bytes = Vec::new();
        for segment in segments {
            self.read(at, segment, &mut bytes)
                .map_err(|source| StoreError::Read { path: self.map.join(&self.name), source })?;
            if verify && SegmentName::of(&bytes) != *segment {
                return Err(self.damaged(Damage::Checksum { file: self.name.clone(), at }));
            }
            visit(&bytes)
                .map_err(|problem| self.damaged(Damage::Segment { file: self.name.clone(), at, problem }))?;
            at += segment.bytes;
        }
        Ok(())
    }

    fn read(&mut self, at: u64, segment: &SegmentName, bytes: &mut Vec<u8>) -> std::io::Result<()> {
        bytes.clear();
        let length = usize::try_from(segment.bytes).map_err(|_| ErrorKind::OutOfMemory)?;
        bytes.try_reserve_exact(length).map_err(|_| ErrorKind::OutOfMemory)?;
        self.file.seek(SeekFrom::Start(at))?;
        (&self.file).take(segment.bytes).read_to_end(bytes)?;
        if bytes.len() == length { Ok(()) } else { Err(ErrorKind::UnexpectedEof.into()) }
    }

    fn damaged(&self, damage: Damage) -> StoreError {
        StoreError::Damaged { path: self.map.clone(), damage }
    }
}

/// Adds what the next segment holds.
fn append<E: Element>(all: &mut Vec<E>, more: Vec<E>) -> Result<(), SegmentError> {
    if let (Some(last), Some(first)) = (all.last(), more.first())
        && last.key() >= first.key()
    {
        return Err(SegmentError::Order { record: E::TABLE.describe(first.key().as_ref()) });
    }
    all.extend(more);
    Ok(())
}
