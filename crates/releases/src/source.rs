//! A store and the cache of what is served of it.

use crate::cache::ReleaseCache;
use crate::error::{ReleaseError, with_causes};
use crate::place::ReleaseChoice;
use crate::release::Release;
use crate::store::ReleaseStore;
use std::path::Path;

/// The releases of one map, with a cache of what was fetched.
#[derive(Clone, Debug)]
pub struct ReleaseSource {
    /// Where they are published.
    pub store: ReleaseStore,
    /// What is served when the store is away.
    pub cache: ReleaseCache,
    /// Which release is followed.
    pub choice: ReleaseChoice,
}

impl ReleaseSource {
    /// Opens the cache of a store whose newest live release is followed.
    ///
    /// # Errors
    /// [`ReleaseError::Cache`].
    pub fn open(store: ReleaseStore, cache: &Path) -> Result<Self, ReleaseError> {
        Ok(Self { store, cache: ReleaseCache::open(cache)?, choice: ReleaseChoice::Newest })
    }

    /// The same store, of which another choice is followed.
    #[must_use]
    pub fn following(self, choice: ReleaseChoice) -> Self {
        Self { choice, ..self }
    }

    /// The release that is to be served now; `None` where there is none yet.
    ///
    /// # Errors
    /// As [`ReleaseChoice::followed`].
    pub async fn newest(&self) -> Result<Option<Release>, ReleaseError> {
        self.choice.followed(&self.store).await
    }

    /// The release that is to be served, or where none can be read the one that was served last, if that is of the same choice.
    ///
    /// # Errors
    /// [`ReleaseError::NoRelease`] and [`ReleaseError::NoCandidate`] where the store has not what was chosen; [`ReleaseError::Empty`], and
    /// as [`ReleaseStore::release`], where nothing is cached either.
    pub async fn newest_or_cached(&self) -> Result<Release, ReleaseError> {
        let error = match self.newest().await {
            Ok(Some(release)) => return Ok(release),
            Ok(None) => ReleaseError::Empty { place: self.store.place().to_owned() },
            Err(error) => error,
        };
        let is_readable = matches!(error, ReleaseError::NoRelease { .. } | ReleaseError::NoCandidate { .. });
        let cached = self.cache.release().filter(|release| !is_readable && self.choice.is_of(release));
        let Some(release) = cached else { return Err(error) };
        let reason = with_causes(&error);
        tracing::warn!(
            release = release.number,
            reason,
            "no release can be read; serving the one that was served last"
        );
        Ok(release)
    }

    /// Notes which release is served from now on, while the former one may still need what it has. A cache that cannot be written is logged
    /// and not used.
    ///
    /// # Returns
    /// Whether it is noted.
    pub fn note(&self, release: &Release) -> bool {
        let noted = self.cache.note_release(release);
        if let Err(error) = &noted {
            let reason = with_causes(error);
            tracing::warn!(reason, "the release is not kept: a restart needs the store");
        }
        noted.is_ok()
    }

    /// Removes what other releases than the one that is served need. What cannot be removed is logged.
    pub fn clean(&self, release: &Release) {
        if let Err(error) = self.cache.remove_others(release) {
            let reason = with_causes(&error);
            tracing::warn!(reason, "what former releases need stays in the cache");
        }
    }

    /// [`Self::note`] and [`Self::clean`]: of a map that needs nothing of its former release any more.
    pub fn keep(&self, release: &Release) {
        if self.note(release) {
            self.clean(release);
        }
    }
}
