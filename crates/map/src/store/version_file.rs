//! The segments of one version, open for reading.

use std::fs::File;
use std::io::{ErrorKind, Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};

use protocol::{KeyframeId, LandmarkId};

use super::error::{Damage, StoreError};
use super::folder::file_of;
use crate::added::{AddedFeatures, FeatureKind};
use crate::contents::MapContents;
use crate::file::manifest::Manifest;
use crate::file::record::{Element, RecordError, Table};
use crate::file::segment::{Layout, OF_IMAGES, OF_MAP, Segment, SegmentError, SegmentName, visit_records};

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

    /// Reads all but the landmarks and the images; the added kinds of features are there without their landmarks.
    pub(super) fn read_frame(&mut self) -> Result<MapContents, StoreError> {
        let mut contents = MapContents::empty(self.manifest.map.clone());
        let added = |kind: &FeatureKind| AddedFeatures { kind: kind.clone(), landmarks: Vec::new() };
        contents.added_features = self.manifest.added_features.iter().map(|of| added(&of.kind)).collect();
        self.visit_segments(0, &self.manifest.frame.clone(), true, |bytes| {
            let Segment { keyframes, cross_covariances, common_errors, aliases, existence, .. } =
                Segment::decode_frame(bytes)?;
            append(&mut contents.keyframes, keyframes)?;
            append(&mut contents.cross_covariances, cross_covariances)?;
            append(&mut contents.common_errors, common_errors)?;
            append(&mut contents.aliases, aliases)?;
            append(&mut contents.existence, existence)
        })?;
        Ok(contents)
    }

    /// Visits the payloads of the landmarks' records by id.
    ///
    /// # Arguments
    /// * `added`: of which added kind of features; `None` for those of the primary kind.
    /// * `verify`: whether each segment must have its SHA-256, as the first time that it is read.
    pub(super) fn visit_landmarks(
        &mut self,
        added: Option<usize>,
        verify: bool,
        visit: impl FnMut(LandmarkId, &[u8]) -> Result<(), RecordError>,
    ) -> Result<(), StoreError> {
        let Manifest { frame, landmarks, added_features, .. } = &self.manifest;
        let before = added_features[..added.unwrap_or(0)].iter().flat_map(|of| &of.landmarks);
        let start = match added {
            None => bytes_of(frame),
            Some(_) => bytes_of(frame) + bytes_of(landmarks) + bytes_of(before),
        };
        let segments = added.map_or(landmarks, |at| &added_features[at].landmarks).clone();
        self.visit_records((start, &segments), OF_MAP, Table::Landmarks, verify, visit)
    }

    /// Visits the payloads of the images' records by keyframe. Every segment must have its SHA-256.
    pub(super) fn visit_images(
        &mut self,
        visit: impl FnMut(KeyframeId, &[u8]) -> Result<(), RecordError>,
    ) -> Result<(), StoreError> {
        let (start, segments) = self.images();
        self.visit_records((start, &segments), OF_IMAGES, Table::Images, true, visit)
    }

    /// Where the segments of images begin, and which they are.
    pub(super) fn images(&self) -> (u64, Vec<SegmentName>) {
        let images = self.manifest.images.clone();
        (self.manifest.bytes() - bytes_of(&images), images)
    }

    /// Visits the payloads of records in segments that hold nothing else and follow each other.
    ///
    /// # Arguments
    /// * `segments`: with the byte at which the first one begins.
    pub(super) fn visit_records(
        &mut self,
        (start, segments): (u64, &[SegmentName]),
        layout: &Layout,
        table: Table,
        verify: bool,
        mut visit: impl FnMut(u64, &[u8]) -> Result<(), RecordError>,
    ) -> Result<(), StoreError> {
        let mut previous = None;
        self.visit_segments(start, segments, verify, |bytes| {
            previous = visit_records(bytes, layout, table, previous, &mut visit)?;
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

fn bytes_of<'a>(segments: impl IntoIterator<Item = &'a SegmentName>) -> u64 {
    segments.into_iter().map(|segment| segment.bytes).fold(0, u64::saturating_add)
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
