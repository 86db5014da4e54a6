//! A store and the cache of what is served of it.

use crate::cache::{NotedRelease, ReleaseCache};
use crate::error::{ReleaseError, with_causes};
use crate::place::ReleaseChoice;
use crate::release::Release;
use crate::store::ReleaseStore;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

/// The releases of one map, with a cache of what was fetched.
#[derive(Clone, Debug)]
pub struct ReleaseSource {
    /// Where they are published.
    pub store: ReleaseStore,
    /// What is served when the store is away.
    pub cache: ReleaseCache,
    /// Which release is followed.
    pub choice: ReleaseChoice,
    /// Of all copies: the release that was read last.
    last_read: Arc<Mutex<Option<LastRead>>>,
}

/// What is noted of a release if it is served. It was read with the release: the store may be away by then.
#[derive(Clone, Debug)]
struct LastRead {
    release: Release,
    noted: Arc<NotedRelease>,
}

impl ReleaseSource {
    /// Opens the cache of a store whose newest live release is followed.
    ///
    /// # Errors
    /// [`ReleaseError::Cache`].
    pub fn open(store: ReleaseStore, cache: &Path) -> Result<Self, ReleaseError> {
        let cache = ReleaseCache::open(cache)?;
        Ok(Self { store, cache, choice: ReleaseChoice::Newest, last_read: Arc::default() })
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
        let Some(read) = self.choice.read_followed(&self.store).await? else { return Ok(None) };
        self.remember(&read.release, NotedRelease::of(self.store.place(), &read.release, &read.file));
        Ok(Some(read.release))
    }

    /// The release that is to be served, or where none can be read the one that was served last, if that is of the same store and choice, and
    /// signed where it must be. If the newest release is not signed, that is an error; it does not fall back to the cache.
    ///
    /// # Errors
    /// [`ReleaseError::NoRelease`] and [`ReleaseError::NoCandidate`] where the store has not what was chosen, [`ReleaseError::NotSigned`];
    /// [`ReleaseError::Empty`], and as [`ReleaseStore::release`], where nothing is cached either.
    pub async fn newest_or_cached(&self) -> Result<Release, ReleaseError> {
        let error = match self.newest().await {
            Ok(Some(release)) => return Ok(release),
            Ok(None) => ReleaseError::Empty { place: self.store.place().to_owned() },
            Err(error) => error,
        };
        let is_final = matches!(
            error,
            ReleaseError::NoRelease { .. }
                | ReleaseError::NoCandidate { .. }
                | ReleaseError::NotSigned { .. }
        );
        if is_final {
            return Err(error);
        }
        let source = self.clone();
        let reading = tokio::task::spawn_blocking(move || source.cached());
        let cached = reading.await.ok().flatten().filter(|(release, _)| self.choice.is_of(release));
        let Some((release, noted)) = cached else { return Err(error) };
        self.remember(&release, noted);
        let reason = with_causes(&error);
        tracing::warn!(
            release = release.number,
            reason,
            "no release can be read; serving the one that was served last"
        );
        Ok(release)
    }

    /// The release that was served last, where it is of this store, and signed if it must be. A cache of an earlier program, which names no
    /// store, counts where no key is given.
    fn cached(&self) -> Option<(Release, NotedRelease)> {
        let noted = self.cache.noted()?;
        if let Some(place) = noted.place.as_deref().filter(|place| *place != self.store.place()) {
            tracing::warn!(place, "the release in the cache is not used: it is of another store");
            return None;
        }
        let signature = noted.signature.as_ref().map(String::as_bytes);
        if let Err(reason) = self.store.verify(noted.file.as_bytes(), signature) {
            tracing::warn!(
                %reason,
                "the release in the cache is not used: it is not signed with the key that was given"
            );
            return None;
        }
        Some((noted.release()?, noted))
    }

    /// Notes which release is served from now on, while the former one may still need what it has. The store is read only if the release is
    /// not the one that was read here last. A cache that cannot be written is logged and not used.
    ///
    /// # Returns
    /// Whether it is noted.
    pub async fn note(&self, release: &Release) -> bool {
        let noted = self.try_note(release).await;
        if let Err(error) = &noted {
            let reason = with_causes(error);
            tracing::warn!(reason, "the release is not kept: a restart needs the store");
        }
        noted.is_ok()
    }

    async fn try_note(&self, release: &Release) -> Result<(), ReleaseError> {
        let noted = if let Some(noted) = self.remembered(release) {
            noted
        } else {
            let file = self.store.file_of(release).await?;
            self.remember(release, NotedRelease::of(self.store.place(), release, &file))
        };
        self.cache.note(noted).await
    }

    fn remember(&self, release: &Release, noted: NotedRelease) -> Arc<NotedRelease> {
        let noted = Arc::new(noted);
        let read = LastRead { release: release.clone(), noted: Arc::clone(&noted) };
        *self.last_read.lock().unwrap_or_else(PoisonError::into_inner) = Some(read);
        noted
    }

    /// What is to be noted of a release, if it was the last that was read.
    fn remembered(&self, release: &Release) -> Option<Arc<NotedRelease>> {
        let last = self.last_read.lock().unwrap_or_else(PoisonError::into_inner);
        last.as_ref().filter(|last| last.release == *release).map(|last| Arc::clone(&last.noted))
    }

    /// Removes what other releases than the one that is served need. What cannot be removed is logged.
    pub fn clean(&self, release: &Release) {
        if let Err(error) = self.cache.remove_others(release) {
            let reason = with_causes(&error);
            tracing::warn!(reason, "what former releases need stays in the cache");
        }
    }

    /// [`Self::note`] and [`Self::clean`]: of a map that needs nothing of its former release any more.
    pub async fn keep(&self, release: &Release) {
        if self.note(release).await {
            self.clean(release);
        }
    }
}
