//! Segments and the newest release, kept on disk: what was served once is served again when the store is away.
//!
//! ```text
//! release.json          the release that was served last: its file in the store, its signature, and which store that is
//! segments/{SHA-256}    verified whenever they are read
//! ```

use crate::error::ReleaseError;
use crate::release::Release;
use crate::store::SignedFile;
use bytes::Bytes;
use map::MapMetadata;
use map::file::SegmentName;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

const RELEASE: &str = "release.json";
const SEGMENTS: &str = "segments";

/// The cache of one map.
#[derive(Clone, Debug)]
pub struct ReleaseCache {
    folder: PathBuf,
}

impl ReleaseCache {
    /// Opens or makes a cache.
    ///
    /// # Errors
    /// [`ReleaseError::Cache`].
    pub fn open(folder: &Path) -> Result<Self, ReleaseError> {
        let segments = folder.join(SEGMENTS);
        std::fs::create_dir_all(&segments)
            .map_err(|source| ReleaseError::Cache { path: segments, source })?;
        Ok(Self { folder: folder.to_owned() })
    }

    /// The release that was served last, of whichever store; `None` where there is none that can be read. Its signature is not verified.
    pub fn release(&self) -> Option<Release> {
        self.noted()?.release()
    }

    /// What was noted of the release that was served last.
    pub(crate) fn noted(&self) -> Option<NotedRelease> {
        let text = files::read(self.folder.join(RELEASE), files::MAX_TEXT_BYTES).ok()?;
        serde_json::from_slice(&text).ok().or_else(|| NotedRelease::of_release_alone(text))
    }

    /// Notes which release is served from now on; the segments of others stay until [`Self::remove_others`]. Waits for the disk in
    /// a thread that may block.
    pub(crate) async fn note(&self, noted: Arc<NotedRelease>) -> Result<(), ReleaseError> {
        let (cache, path) = (self.clone(), self.folder.join(RELEASE));
        let writing = tokio::task::spawn_blocking(move || cache.write_noted(&noted));
        let failed = |error: tokio::task::JoinError| ReleaseError::Cache { path, source: error.into() };
        writing.await.map_err(failed).flatten()
    }

    /// Nothing is written where it is noted already: the disk may be full.
    fn write_noted(&self, noted: &NotedRelease) -> Result<(), ReleaseError> {
        if self.noted().is_some_and(|present| present.has_all_of(noted)) {
            return Ok(());
        }
        let path = self.folder.join(RELEASE);
        let text = serde_json::to_vec(noted)
            .map_err(|error| ReleaseError::Cache { path: path.clone(), source: error.into() })?;
        write(&path, &text)
    }

    /// Removes the segments that a release does not need.
    ///
    /// # Errors
    /// [`ReleaseError::Cache`].
    pub fn remove_others(&self, release: &Release) -> Result<(), ReleaseError> {
        let needed: BTreeSet<&str> = release.segments().map(|segment| segment.sha256.as_str()).collect();
        let segments = self.folder.join(SEGMENTS);
        let failed = |source| ReleaseError::Cache { path: segments.clone(), source };
        for entry in std::fs::read_dir(&segments).map_err(failed)? {
            let entry = entry.map_err(failed)?;
            if entry.file_name().to_str().is_none_or(|name| !needed.contains(name)) {
                std::fs::remove_file(entry.path())
                    .map_err(|source| ReleaseError::Cache { path: entry.path(), source })?;
            }
        }
        Ok(())
    }

    /// A segment; `None` where it is missing or damaged.
    pub(crate) fn segment(&self, name: &SegmentName) -> Option<Bytes> {
        let path = self.path(name);
        let bytes = files::read(&path, name.bytes).ok()?;
        if SegmentName::of(&bytes) == *name {
            return Some(bytes.into());
        }
        tracing::warn!(path = %path.display(), "this segment in the cache is damaged; it is fetched again");
        None
    }

    pub(crate) fn keep_segment(&self, name: &SegmentName, bytes: &[u8]) -> Result<(), ReleaseError> {
        write(&self.path(name), bytes)
    }

    fn path(&self, name: &SegmentName) -> PathBuf {
        self.folder.join(SEGMENTS).join(&name.sha256)
    }
}

/// The release that was served last, with all that tells whether it may be served again.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct NotedRelease {
    /// The store that it is of; `None` in a cache that an earlier program wrote.
    pub(crate) place: Option<String>,
    /// Version of its map as it was served, which may be a later one than that of the file.
    pub(crate) version: u64,
    /// Its file in the store.
    pub(crate) file: String,
    /// The signature of the file, where the store had to be signed.
    pub(crate) signature: Option<String>,
}

impl NotedRelease {
    /// What is noted of a release that was read.
    ///
    /// # Arguments
    /// * `place`: the store.
    pub(crate) fn of(place: &str, release: &Release, file: &SignedFile) -> Self {
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        Self {
            place: Some(place.to_owned()),
            version: release.map.version,
            file: text(&file.text),
            signature: file.signature.as_deref().map(text),
        }
    }

    /// Whether another one adds nothing: the same release, without a signature or with the same one.
    fn has_all_of(&self, other: &Self) -> bool {
        let is_same = self.place == other.place && self.version == other.version && self.file == other.file;
        is_same && (other.signature.is_none() || other.signature == self.signature)
    }

    /// That of a cache that has nothing but the release.
    fn of_release_alone(text: Vec<u8>) -> Option<Self> {
        let version = Release::decode_any(&text).ok()?.map.version;
        Some(Self { place: None, version, file: String::from_utf8(text).ok()?, signature: None })
    }

    /// The release as it was served.
    pub(crate) fn release(&self) -> Option<Release> {
        let release = Release::decode_any(self.file.as_bytes()).ok()?;
        Some(Release { map: MapMetadata { version: self.version, ..release.map }, ..release })
    }
}

/// Writes a file that is there as a whole or not at all.
fn write(path: &Path, bytes: &[u8]) -> Result<(), ReleaseError> {
    let begun = path.with_extension("new");
    let written = std::fs::File::create(&begun).and_then(|mut file| {
        file.write_all(bytes)?;
        file.sync_all()
    });
    written.and_then(|()| std::fs::rename(&begun, path)).map_err(|source| {
        // What was begun takes the space that is missing.
        let _ = std::fs::remove_file(&begun);
        ReleaseError::Cache { path: path.to_owned(), source }
    })
}
