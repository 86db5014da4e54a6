//! A served map whose versions are releases in an object store.

use std::path::Path;

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
}

impl ReleasedMap {
    /// Opens a store and its cache.
    ///
    /// # Errors
    /// An invalid URL, a folder that cannot be made.
    pub fn open(place: &ReleasePlace, cache: &Path, key: Option<&ReleaseKey>) -> anyhow::Result<ReleasedMap> {
        let source = ReleaseSource::open(open_store(&place.url, key)?, cache)?;
        Ok(ReleasedMap { source: source.following(place.choice) })
    }

    /// The map of the release that is followed, or where the store is away of the one that was served last. Called in a thread that may
    /// block, within a runtime.
    ///
    /// # Errors
    /// The store has no release, or can't be reached and nothing is cached.
    pub fn load(&self) -> anyhow::Result<LoadedMap> {
        self.load_release(&Handle::current().block_on(self.source.newest_or_cached())?)
    }

    /// The map of the release that is followed, if that is not the one that is served.
    ///
    /// # Errors
    /// The store cannot be read, or what it has is damaged.
    pub fn newer(&self, served: u64, identity: MapIdentity) -> anyhow::Result<Option<LoadedMap>> {
        let newest = Handle::current().block_on(self.source.newest())?;
        let is_served = |release: &Release| (release.map.version, release.identity()) == (served, identity);
        newest.filter(|release| !is_served(release)).map(|release| self.load_release(&release)).transpose()
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
        self.source.keep(release);
        Ok(map)
    }
}
