//! Publishing and cleaning at once: a mark in the store while segments are removed.
//!
//! Whoever publishes puts its segments, then looks for marks, then whether all segments are there, and only then puts the release.
//! Whoever cleans puts its mark before it lists the segments. So either the mark is seen, or the segments that were put are young
//! in the list, or those that were removed are missed. Ages are those by the clock that dates the objects of the store.

use crate::error::ReleaseError;
use crate::release::Release;
use crate::store::ReleaseStore;
use std::collections::BTreeSet;
use std::pin::Pin;
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
    /// When it was put first, s since 1970 by the store's clock.
    put_s: u64,
}

impl<'a> CleaningMark<'a> {
    /// Puts a mark, and removes what killed programs left: marks, and objects that told the time.
    pub(crate) async fn put(store: &'a ReleaseStore) -> Result<CleaningMark<'a>, ReleaseError> {
        let (name, renewed) = (own_name(), Instant::now());
        let put_s = store.put_mark(&name).await?;
        for (other, other_s) in store.marks().await? {
            if is_stale(other_s, put_s) {
                store.remove_mark(&other).await?;
            }
        }
        for (other, other_s) in store.clock_objects().await? {
            if is_stale(other_s, put_s) {
                store.remove_clock_object(&other).await?;
            }
        }
        Ok(CleaningMark { store, name, renewed, put_s })
    }

    /// When it was put first, s since 1970 by the store's clock.
    pub(crate) fn put_s(&self) -> u64 {
        self.put_s
    }

    /// Does a step, and keeps the mark from being taken for one of a killed program, however long the step takes.
    ///
    /// # Errors
    /// [`ReleaseError::MarkLost`] where it may have been taken for one already, and those of the step.
    pub(crate) async fn during<T>(
        &mut self,
        mut step: Pin<&mut impl Future<Output = Result<T, ReleaseError>>>,
    ) -> Result<T, ReleaseError> {
        self.renew().await?;
        loop {
            let due = RENEWAL.saturating_sub(self.renewed.elapsed());
            tokio::select! {
                done = &mut step => return done,
                () = tokio::time::sleep(due) => self.renew().await?,
            }
        }
    }

    async fn renew(&mut self) -> Result<(), ReleaseError> {
        let (now, age) = (Instant::now(), self.renewed.elapsed());
        if age < RENEWAL {
            return Ok(());
        }
        if age > STALE || !self.store.has_mark(&self.name).await? {
            return Err(ReleaseError::MarkLost { place: self.store.place().to_owned() });
        }
        self.store.put_mark(&self.name).await?;
        self.renewed = now;
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
    let marks = store.marks().await?;
    if !marks.is_empty() {
        let now_s = store.now_s(&own_name()).await?;
        if marks.iter().any(|(_, put_s)| !is_stale(*put_s, now_s)) {
            return Err(cleaning());
        }
    }
    let present: BTreeSet<String> = store.segments().await?.into_iter().map(|(name, _)| name).collect();
    let is_there = release.segments().all(|segment| present.contains(&segment.sha256));
    if is_there { Ok(()) } else { Err(cleaning()) }
}

fn is_stale(put_s: u64, now_s: u64) -> bool {
    now_s.saturating_sub(put_s) > STALE.as_secs()
}

/// A name that no other program puts at this time.
fn own_name() -> String {
    format!("{}-{}", std::process::id(), now_unix_ns())
}

/// A clock before 1970 gives 0.
fn now_unix_ns() -> u128 {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    since.map_or(0, |since| since.as_nanos())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::pin::pin;
    use std::time::SystemTime;

    #[tokio::test]
    async fn a_mark_is_renewed_while_a_step_takes_long() {
        let folder = tempfile::tempdir().unwrap();
        let store = ReleaseStore::open(folder.path().to_str().unwrap()).unwrap();
        let mut mark = CleaningMark::put(&store).await.unwrap();
        // It is due in the middle of the step.
        let due = RENEWAL.saturating_sub(Duration::from_millis(200));
        mark.renewed = Instant::now().checked_sub(due).unwrap();
        let step = async {
            tokio::time::sleep(Duration::from_secs(1)).await;
            Ok(7)
        };
        let done = mark.during(pin!(step)).await;
        assert_eq!(done.unwrap(), 7);
        assert!(mark.renewed.elapsed() < RENEWAL / 2);
        // Of a mark that is lost, no step is begun.
        store.remove_mark(&mark.name).await.unwrap();
        mark.renewed = Instant::now().checked_sub(2 * RENEWAL).unwrap();
        let mut is_begun = false;
        let step = async {
            is_begun = true;
            Ok(())
        };
        let lost = mark.during(pin!(step)).await;
        assert!(matches!(lost, Err(ReleaseError::MarkLost { .. })) && !is_begun);
    }

    #[tokio::test]
    async fn objects_that_told_the_time_go_once_nobody_needs_them() {
        let folder = tempfile::tempdir().unwrap();
        let store = ReleaseStore::open(folder.path().to_str().unwrap()).unwrap();
        let clock = folder.path().join("clock");
        std::fs::create_dir_all(&clock).unwrap();
        let [of_killed, of_another] = ["1-1", "2-2"].map(|name| clock.join(name));
        let file = std::fs::File::create(&of_killed).unwrap();
        file.set_modified(SystemTime::now().checked_sub(2 * STALE).unwrap()).unwrap();
        std::fs::File::create(&of_another).unwrap();
        CleaningMark::put(&store).await.unwrap().remove().await.unwrap();
        assert!(!of_killed.exists() && of_another.exists());
    }

    #[tokio::test]
    async fn a_mark_that_others_may_have_taken_for_a_killed_programs_is_lost() {
        let folder = tempfile::tempdir().unwrap();
        let store = ReleaseStore::open(folder.path().to_str().unwrap()).unwrap();
        let mut mark = CleaningMark::put(&store).await.unwrap();
        let ago = |age: Duration| Instant::now().checked_sub(age).unwrap();
        mark.renewed = ago(2 * RENEWAL);
        mark.renew().await.unwrap();
        assert!(mark.renewed.elapsed() < RENEWAL);
        mark.renewed = ago(2 * STALE);
        assert!(matches!(mark.renew().await, Err(ReleaseError::MarkLost { .. })));
        mark.renewed = ago(2 * RENEWAL);
        store.remove_mark(&mark.name).await.unwrap();
        assert!(matches!(mark.renew().await, Err(ReleaseError::MarkLost { .. })));
    }
}
