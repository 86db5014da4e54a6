//! Segments and the newest release, kept on disk: what was served once is served again when the store is away.
//!
//! ```text
//! release.json          the release that was served last
//! segments/{SHA-256}    verified whenever they are read
//! ```

use crate::error::ReleaseError;
use crate::release::Release;
use bytes::Bytes;
use map::file::SegmentName;
use std::collections::BTreeSet;
use std::io::Write as _;
use std::path::{Path, PathBuf};

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

    /// The release that was served last; `None` where there is none that can be read.
    pub fn release(&self) -> Option<Release> {
        let text = files::read(self.folder.join(RELEASE), files::MAX_TEXT_BYTES).ok()?;
        Release::decode_any(&text).ok()
    }

    /// Notes which release is served from now on; the segments of others stay until [`Self::remove_others`].
    ///
    /// # Errors
    /// [`ReleaseError::Cache`].
    pub fn note_release(&self, release: &Release) -> Result<(), ReleaseError> {
        let path = self.folder.join(RELEASE);
        let text = serde_json::to_vec_pretty(release)
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
