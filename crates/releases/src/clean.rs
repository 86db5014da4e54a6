//! Removing what no release needs.

use crate::cleaning::CleaningMark;
use crate::error::ReleaseError;
use crate::publish::now_unix_s;
use crate::store::{ReleaseStore, put_s};
use object_store::ObjectMeta;
use std::collections::BTreeSet;
use std::pin::pin;
use std::time::Duration;

/// What is kept.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct CleanOptions {
    /// Newest releases that are kept, at least one.
    pub releases: usize,
    /// Segments that were put within this time are kept: a release that names them may be about to come.
    pub grace: Duration,
    /// Remove nothing, only say what would be.
    pub dry_run: bool,
}

impl Default for CleanOptions {
    fn default() -> Self {
        Self { releases: 10, grace: Duration::from_hours(24), dry_run: false }
    }
}

/// What was removed.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Cleaned {
    /// Numbers of releases.
    pub releases: Vec<u64>,
    /// Numbers of candidates.
    pub candidates: Vec<u64>,
    /// Names of segments.
    pub segments: Vec<String>,
    /// Bytes of the segments.
    pub bytes: u64,
}

/// Removes all releases but the newest ones, and the segments that the remaining ones do not name.
///
/// Candidates for the numbers of removed releases go with them, and so does one for the number of the oldest release that stays: what
/// may still be promoted stays. The newest candidate stays in any case, so that no number comes again.
///
/// What is published meanwhile keeps its segments, or is refused ([`ReleaseError::Cleaning`]).
///
/// # Errors
/// [`ReleaseError::Store`]; [`ReleaseError::Damaged`] for a release that cannot be read: nothing is removed then; [`ReleaseError::MarkLost`] where
/// the store was away for so long that something may be published meanwhile.
pub async fn clean(store: &ReleaseStore, options: &CleanOptions) -> Result<Cleaned, ReleaseError> {
    if options.dry_run {
        return clean_marked(store, options, None).await;
    }
    let mut mark = CleaningMark::put(store).await?;
    let cleaned = clean_marked(store, options, Some(&mut mark)).await;
    mark.remove().await?;
    cleaned
}

/// # Arguments
/// * `mark`: that of this program; `None` where nothing is to be removed.
async fn clean_marked(
    store: &ReleaseStore,
    options: &CleanOptions,
    mut mark: Option<&mut CleaningMark<'_>>,
) -> Result<Cleaned, ReleaseError> {
    // The time is read and segments are listed first: what is put later is younger than the grace time, however long the rest takes.
    let now_s = mark.as_ref().map_or_else(now_unix_s, |mark| mark.put_s());
    let oldest = now_s.saturating_sub(options.grace.as_secs());
    let segments = marked(&mut mark, store.segments()).await?;
    let numbers = marked(&mut mark, store.numbers()).await?;
    let (former, kept) = numbers.split_at(numbers.len().saturating_sub(options.releases.max(1)));
    let mut needed = BTreeSet::new();
    for number in kept {
        let release = marked(&mut mark, store.release(*number)).await?;
        needed.extend(release.segments().map(|segment| segment.sha256.clone()));
    }
    let candidates = candidates_before(store, kept, &mut needed, &mut mark).await?;
    let mut cleaned = Cleaned { releases: former.to_vec(), candidates, ..Cleaned::default() };
    // A release goes before its segments, so that no release lacks any.
    if mark.is_some() {
        for number in &cleaned.releases {
            marked(&mut mark, store.remove_release(*number)).await?;
        }
        for number in &cleaned.candidates {
            marked(&mut mark, store.remove_candidate(*number)).await?;
        }
    }
    for (name, object) in segments {
        if needed.contains(&name) || put_s(&object) > oldest {
            continue;
        }
        if mark.is_some() && !marked(&mut mark, remove_unless_renewed(store, &name, &object)).await? {
            continue;
        }
        cleaned.bytes = cleaned.bytes.saturating_add(object.size);
        cleaned.segments.push(name);
    }
    Ok(cleaned)
}

/// Does a step, while the mark is kept if there is one.
async fn marked<T>(
    mark: &mut Option<&mut CleaningMark<'_>>,
    step: impl Future<Output = Result<T, ReleaseError>>,
) -> Result<T, ReleaseError> {
    let step = pin!(step);
    match mark {
        Some(mark) => mark.during(step).await,
        None => step.await,
    }
}

/// Removes a segment, unless somebody has put it again since it was listed, or removed it.
///
/// # Returns
/// Whether it was removed.
async fn remove_unless_renewed(
    store: &ReleaseStore,
    name: &str,
    listed: &ObjectMeta,
) -> Result<bool, ReleaseError> {
    let found = store.segment_found(name).await?;
    if found.is_none_or(|found| found.last_modified > listed.last_modified) {
        return Ok(false);
    }
    store.remove_segment(name).await?;
    Ok(true)
}

/// The candidates that go with former releases.
///
/// # Arguments
/// * `kept`: numbers of the releases that stay.
/// * `needed`: gets the segments of the candidates that stay.
async fn candidates_before(
    store: &ReleaseStore,
    kept: &[u64],
    needed: &mut BTreeSet<String>,
    mark: &mut Option<&mut CleaningMark<'_>>,
) -> Result<Vec<u64>, ReleaseError> {
    let oldest = kept.first().copied().unwrap_or(0);
    let numbers = marked(mark, store.candidate_numbers()).await?;
    let mut going = Vec::new();
    for number in &numbers {
        let candidate = marked(mark, store.candidate(*number)).await?;
        if candidate.number <= oldest && Some(number) != numbers.last() {
            going.push(*number);
        } else {
            needed.extend(candidate.segments().map(|segment| segment.sha256.clone()));
        }
    }
    Ok(going)
}

#[cfg(test)]
mod tests {
    use super::*;
    use map::file::SegmentName;

    #[tokio::test]
    async fn a_segment_that_was_put_again_since_it_was_listed_stays() {
        let folder = tempfile::tempdir().unwrap();
        let store = ReleaseStore::open(folder.path().to_str().unwrap()).unwrap();
        let bytes = b"a cell".to_vec();
        let name = SegmentName::of(&bytes);
        store.put_segment(&name, bytes.clone()).await.unwrap();
        let (_, listed) = store.segments().await.unwrap().remove(0);
        tokio::time::sleep(Duration::from_millis(30)).await;
        store.put_segment(&name, bytes).await.unwrap();
        assert!(!remove_unless_renewed(&store, &name.sha256, &listed).await.unwrap());
        let (_, listed) = store.segments().await.unwrap().remove(0);
        assert!(remove_unless_renewed(&store, &name.sha256, &listed).await.unwrap());
        assert!(!remove_unless_renewed(&store, &name.sha256, &listed).await.unwrap(), "it is gone");
    }
}
