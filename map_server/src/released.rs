//! A served map whose versions are releases in an object store.

use std::path::Path;

use anyhow::Context;
use protocol::MapIdentity;
use recognition::LoadedMap;
use releases::{Release, ReleaseCache, ReleaseError, ReleaseKey, ReleaseStore, fetch};
use tokio::runtime::Handle;

/// Opens a store whose releases must be signed with a key, if there is one.
///
/// # Errors
/// A URL that is none.
pub fn open_store(url: &str, key: Option<&ReleaseKey>) -> Result<ReleaseStore, ReleaseError> {
    let store = ReleaseStore::open(url)?;
    Ok(match key {
        Some(key) => store.signed_with(key.clone()),
        None => store,
    })
}

/// The releases of one map, with a cache of what was fetched.
#[derive(Clone, Debug)]
pub struct ReleasedMap {
    store: ReleaseStore,
    cache: ReleaseCache,
}

impl ReleasedMap {
    /// Opens a store and its cache.
    ///
    /// # Errors
    /// A URL that is none, a folder that cannot be made.
    pub fn open(url: &str, cache: &Path, key: Option<&ReleaseKey>) -> anyhow::Result<ReleasedMap> {
        Ok(ReleasedMap { store: open_store(url, key)?, cache: ReleaseCache::open(cache)? })
    }

    /// The map of the newest release, or where the store is away of the one that was served last. Called in a thread that may
    /// block, within a runtime.
    ///
    /// # Errors
    /// The store has no release, or can't be reached and nothing is cached.
    pub fn load(&self) -> anyhow::Result<LoadedMap> {
        let place = self.store.place();
        let newest = match Handle::current().block_on(self.store.newest()) {
            Ok(newest) => newest.with_context(|| {
                format!("{place} has no release: publish one with driftless publish-map --to {place}")
            }),
            Err(error) => Err(error.into()),
        };
        let release = newest.or_else(|error| {
            let Some(release) = self.cache.release() else { return Err(error) };
            let (number, reason) = (release.number, format!("{error:#}"));
            tracing::warn!(
                release = number,
                reason,
                "no release can be read; serving the one that was served last"
            );
            Ok(release)
        })?;
        self.load_release(&release)
    }

    /// The map of the newest release, if that is not the one that is served.
    ///
    /// # Errors
    /// The store cannot be read, or what it has is damaged.
    pub fn newer(&self, served: u64, identity: MapIdentity) -> anyhow::Result<Option<LoadedMap>> {
        let newest = Handle::current().block_on(self.store.newest())?;
        let is_served = |release: &Release| (release.map.version, release.map.identity) == (served, identity);
        newest.filter(|release| !is_served(release)).map(|release| self.load_release(&release)).transpose()
    }

    fn load_release(&self, release: &Release) -> anyhow::Result<LoadedMap> {
        let contents = Handle::current().block_on(fetch(&self.store, release, Some(&self.cache)))?;
        let map = LoadedMap::from_contents(contents)
            .with_context(|| format!("release {} of {}", release.number, self.store.place()))?;
        tracing::info!(
            place = self.store.place(),
            release = release.number,
            cells = release.cells.len(),
            bytes = release.bytes(),
            "fetched a release"
        );
        if let Err(error) = self.cache.keep_release(release) {
            let reason = format!("{:#}", anyhow::Error::from(error));
            tracing::warn!(reason, "the release is not kept: a restart needs the store");
        }
        Ok(map)
    }
}
