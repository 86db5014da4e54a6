//! A served map whose versions are releases in an object store.

use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use anyhow::Context;
use protocol::MapIdentity;
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

    /// The release that is followed, or where the store is away the one that was served last, and its map. Called in a thread that may
    /// block, within a runtime.
    ///
    /// # Errors
    /// The store has no release, or can't be reached and nothing is cached.
    pub fn load(&self) -> anyhow::Result<(LoadedMap, Release)> {
        let release = Handle::current().block_on(self.source.newest_or_cached())?;
        Ok((self.load_release(&release)?, release))
    }

    /// The release that is followed and its map, if that is not the one that is served, nor one that was refused.
    ///
    /// # Errors
    /// The store cannot be read, or what it has is damaged.
    pub fn newer(&self, served: u64, identity: MapIdentity) -> anyhow::Result<Option<(LoadedMap, Release)>> {
        let Some(newest) = Handle::current().block_on(self.source.newest())? else { return Ok(None) };
        let is_served = (newest.map.version, newest.identity()) == (served, identity);
        if is_served || self.refused().as_ref() == Some(&newest) {
            return Ok(None);
        }
        Ok(Some((self.load_release(&newest)?, newest)))
    }

    /// Notes that a release is served now: what the cache has of others is removed.
    pub fn keep(&self, release: &Release) {
        self.source.keep(release);
    }

    /// Notes that a release was refused. It is not loaded again.
    pub fn refuse(&self, release: Release) {
        *self.refused() = Some(release);
    }

    /// The release that was refused is loaded again.
    pub fn look_again(&self) {
        *self.refused() = None;
    }

    fn refused(&self) -> MutexGuard<'_, Option<Release>> {
        self.refused.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn load_release(&self, release: &Release) -> anyhow::Result<LoadedMap> {
        let ReleaseSource { store, cache, .. } = &self.source;
        let contents = Handle::current().block_on(fetch_without_images(store, release, Some(cache)))?;
        let map = LoadedMap::from_contents(contents)
            .with_context(|| format!("{} of {}", release.title(), store.place()))?;
        tracing::info!(
            place = store.place(),
            release = release.title(),
            cells = release.cells.len(),
            bytes = release.bytes(),
            "fetched a release"
        );
        Ok(map)
    }
}
