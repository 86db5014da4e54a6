//! A served map whose versions are releases in an object store.

use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use anyhow::Context;
use recognition::LoadedMap;
use releases::{
    Release, ReleaseError, ReleaseKey, ReleasePlace, ReleaseSource, ReleaseStore, fetch_without_images,
};
use tokio::runtime::Handle;

/// Opens a store whose releases must be signed with a key, if there is one.
///
/// # Errors
/// An invalid URL.
pub fn open_store(url: &str, key: Option<&ReleaseKey>) -> Result<ReleaseStore, ReleaseError> {
    let store = ReleaseStore::open(url)?;
    Ok(match key {
        Some(key) => store.signed_with(key.clone()),
        None => store,
    })
}

/// A map and its releases.
#[derive(Clone, Debug)]
pub struct ReleasedMap {
    source: ReleaseSource,
    /// The one that was loaded last and refused: it would be again.
    refused: Arc<Mutex<Option<Release>>>,
}

impl ReleasedMap {
    /// Opens a store and its cache.
    ///
    /// # Errors
    /// An invalid URL, a folder that cannot be made.
    pub fn open(place: &ReleasePlace, cache: &Path, key: Option<&ReleaseKey>) -> anyhow::Result<ReleasedMap> {
        let source = ReleaseSource::open(open_store(&place.url, key)?, cache)?;
        Ok(ReleasedMap { source: source.following(place.choice), refused: Arc::default() })
    }

    /// The release that is followed, or where the store is away the one that was served last. Called in a thread that may block, within a
    /// runtime.
    ///
    /// # Errors
    /// The store has no release, or can't be reached and nothing is cached.
    pub fn newest_or_cached(&self) -> anyhow::Result<Release> {
        Ok(Handle::current().block_on(self.source.newest_or_cached())?)
    }

    /// The release that is followed; `None` where there is none yet.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn newest(&self) -> anyhow::Result<Option<Release>> {
        Ok(Handle::current().block_on(self.source.newest())?)
    }

    /// The map of a release.
    ///
    /// # Arguments
    /// * `number`: of its version, for robots.
    ///
    /// # Errors
    /// The store cannot be read, or what it has is damaged.
    pub fn load(&self, release: &Release, number: u64) -> anyhow::Result<LoadedMap> {
        let ReleaseSource { store, cache, .. } = &self.source;
        let mut contents = Handle::current().block_on(fetch_without_images(store, release, Some(cache)))?;
        contents.info.version = number;
        let map = LoadedMap::from_contents(contents)
            .with_context(|| format!("{} of {}", release.title(), store.place()))?;
        tracing::info!(
            place = store.place(),
            release = release.title(),
            cells = release.cells.len(),
            bytes = release.bytes(),
            "fetched a release"
        );
        Ok(map.with_digest(release.digest))
    }

    /// Notes that a release is served from now on: what the cache has of others is removed. Called in a thread that may block, within a
    /// runtime.
    pub fn keep(&self, release: &Release) {
        Handle::current().block_on(self.source.keep(release));
    }

    /// Notes that a release was refused. It is not loaded again.
    pub fn refuse(&self, release: Release) {
        *self.refused() = Some(release);
    }

    /// Whether a release was the last to be refused.
    pub fn is_refused(&self, release: &Release) -> bool {
        self.refused().as_ref() == Some(release)
    }

    /// The release that was refused is loaded again.
    pub fn look_again(&self) {
        *self.refused() = None;
    }

    fn refused(&self) -> MutexGuard<'_, Option<Release>> {
        self.refused.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
