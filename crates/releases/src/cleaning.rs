//! Publishing and cleaning at once: a mark in the store while segments are removed.
//!
//! Whoever publishes puts its segments, then looks for marks, then whether all segments are there, and only then puts the release.
//! Whoever cleans puts its mark before it lists the segments. So either the mark is seen, or the segments that were put are young
//! in the list, or those that were removed are missed.

use crate::error::ReleaseError;
use crate::publish::now_unix_s;
use crate::release::Release;
use crate::store::ReleaseStore;
use std::collections::BTreeSet;
use std::time::{Duration, Instant};

/// A mark that is not renewed for so long is of a killed program.
const STALE: Duration = Duration::from_mins(1);
/// Time between two renewals.
const RENEWAL: Duration = Duration::from_secs(10);

/// The mark of one program that removes segments.
pub(crate) struct CleaningMark<'a> {
    store: &'a ReleaseStore,
    name: String,
    renewed: Instant,
}

impl<'a> CleaningMark<'a> {
    /// Puts a mark, and removes those of killed programs.
    pub(crate) async fn put(store: &'a ReleaseStore) -> Result<CleaningMark<'a>, ReleaseError> {
        let name = format!("{}-{}", std::process::id(), now_unix_ns());
        store.put_mark(&name).await?;
        for (other, put_s) in store.marks().await? {
            if is_stale(put_s) {
                store.remove_mark(&other).await?;
            }
        }
        Ok(CleaningMark { store, name, renewed: Instant::now() })
    }

    /// Keeps the mark from being taken for one of a killed program.
    pub(crate) async fn renew(&mut self) -> Result<(), ReleaseError> {
        if self.renewed.elapsed() > RENEWAL {
            self.store.put_mark(&self.name).await?;
            self.renewed = Instant::now();
        }
        Ok(())
    }

    /// Removes the mark.
    pub(crate) async fn remove(self) -> Result<(), ReleaseError> {
        self.store.remove_mark(&self.name).await
    }
}

/// Ensures that all segments of a release are there, and stay.
///
/// # Errors
/// [`ReleaseError::Cleaning`].
pub(crate) async fn ensure_kept(store: &ReleaseStore, release: &Release) -> Result<(), ReleaseError> {
    let cleaning = || ReleaseError::Cleaning { place: store.place().to_owned() };
    if store.marks().await?.iter().any(|(_, put_s)| !is_stale(*put_s)) {
        return Err(cleaning());
    }
    let present: BTreeSet<String> = store.segments().await?.into_iter().map(|(name, _)| name).collect();
    let is_there = release.segments().all(|segment| present.contains(&segment.sha256));
    if is_there { Ok(()) } else { Err(cleaning()) }
}

fn is_stale(put_s: u64) -> bool {
    now_unix_s().saturating_sub(put_s) > STALE.as_secs()
}

/// A clock before 1970 gives 0.
fn now_unix_ns() -> u128 {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    since.map_or(0, |since| since.as_nanos())
}
