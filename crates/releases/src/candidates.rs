//! Candidates: promoting and rejecting them, and what servers take that follow them.
//!
//! A candidate states the number that it would have among the live releases. Promoting puts it under that number, if that is free: so
//! it follows the release that it was compared with, or is refused. Before, the decision is put, if there is none: of two people who
//! decide at once, one is told what the other decided. A promotion that was interrupted is ended by promoting again.

use crate::cleaning::ensure_kept;
use crate::error::{ReleaseError, with_causes};
use crate::publish::{now_unix_s, renew};
use crate::release::Release;
use crate::stage::{CandidateState, Decision, Note, Stage, Verdict};
use crate::store::{ReadRelease, ReleaseStore};

/// Makes a candidate the next live release.
///
/// It keeps the version of its map, so robots that use it already are told nothing.
///
/// # Returns
/// The live release; that which it is already, where it was promoted before.
///
/// # Errors
/// [`ReleaseError::NoCandidate`], [`ReleaseError::Overtaken`] where another release came since, [`ReleaseError::Decided`] where it was
/// rejected, [`ReleaseError::SourceNotSigned`] where the store signs and the candidate is not signed with its key,
/// [`ReleaseError::Conflict`], [`ReleaseError::Cleaning`], [`ReleaseError::TooLong`], [`ReleaseError::LongLedger`], [`ReleaseError::Store`].
pub async fn promote(store: &ReleaseStore, candidate: u64, note: &Note) -> Result<Release, ReleaseError> {
    let proposed = store.candidate_to_sign(candidate).await?;
    let newest = store.newest().await?;
    if let Some(live) = newest.as_ref().filter(|newest| newest.candidate == Some(candidate)) {
        return Ok(live.clone());
    }
    // A number that is taken is no longer free: it cannot overtake anything.
    ensure_next(newest.as_ref(), &proposed, candidate)?;
    let release = Release {
        stage: Stage::Live,
        published_unix_s: now_unix_s(),
        promotion: Some(note.clone()),
        ..proposed.clone()
    };
    let release = store.fitted(release)?;
    renew(store, newest.as_ref(), &release).await?;
    ensure_kept(store, &release).await?;
    let decision = decide(store, &proposed, candidate, Verdict::Promoted, note).await?;
    if decision.verdict == Verdict::Rejected {
        return Err(decided(decision));
    }
    store.put_release(&release).await?;
    Ok(release)
}

/// Rejects a candidate: it will not be live. Robots that use it are led back by servers that follow candidates.
///
/// # Errors
/// [`ReleaseError::NoCandidate`], [`ReleaseError::Decided`] where it was promoted or rejected before, [`ReleaseError::Store`].
pub async fn reject(store: &ReleaseStore, candidate: u64, note: &Note) -> Result<Decision, ReleaseError> {
    let proposed = store.candidate(candidate).await?;
    if let Some(decision) = store.decision(&proposed).await? {
        return Err(decided(decision));
    }
    let decision = decide(store, &proposed, candidate, Verdict::Rejected, note).await?;
    if decision.verdict == Verdict::Rejected { Ok(decision) } else { Err(decided(decision)) }
}

/// What became of a candidate.
///
/// # Errors
/// As [`ReleaseStore::release`].
pub async fn candidate_state(
    store: &ReleaseStore,
    proposed: &Release,
    newest: Option<&Release>,
) -> Result<CandidateState, ReleaseError> {
    let taken = newest.filter(|newest| newest.number >= proposed.number);
    Ok(match store.decision(proposed).await? {
        Some(decision) if decision.verdict == Verdict::Rejected => CandidateState::Rejected(decision),
        Some(decision) => match taken {
            Some(_) if !is_promoted(store, proposed).await? => {
                CandidateState::Overtaken { by: proposed.number }
            }
            _ => CandidateState::Promoted(decision),
        },
        None => taken.map_or(CandidateState::Open, |_| CandidateState::Overtaken { by: proposed.number }),
    })
}

/// The newest candidate that nothing was decided about.
///
/// # Errors
/// [`ReleaseError::NoCandidate`], and as [`ReleaseStore::release`].
pub async fn newest_open(store: &ReleaseStore) -> Result<Release, ReleaseError> {
    let newest = store.newest().await?;
    for number in store.candidate_numbers().await?.into_iter().rev() {
        let proposed = store.candidate(number).await?;
        if candidate_state(store, &proposed, newest.as_ref()).await? == CandidateState::Open {
            return Ok(proposed);
        }
    }
    Err(ReleaseError::NoCandidate { place: store.place().to_owned(), candidate: None })
}

/// What a server serves that follows candidates: the newest one, or where that was rejected or overtaken the newest live release.
///
/// Versions grow for its robots, too: after a candidate that was rejected, or overtaken by an older one that was promoted, the live map
/// has the version after the candidate's, which no other release has.
///
/// # Errors
/// As [`ReleaseStore::release`].
pub async fn newest_with_candidates(store: &ReleaseStore) -> Result<Option<Release>, ReleaseError> {
    Ok(read_with_candidates(store).await?.map(|read| read.release))
}

/// As [`newest_with_candidates`], with its file.
pub(crate) async fn read_with_candidates(store: &ReleaseStore) -> Result<Option<ReadRelease>, ReleaseError> {
    let newest = store.read_newest().await?;
    let Some(number) = store.candidate_numbers().await?.pop() else { return Ok(newest) };
    let proposed = store.read_candidate(number).await?;
    let live = newest.as_ref().map(|newest| &newest.release);
    if ensure_next(live, &proposed.release, number).is_ok() {
        let decision = store.decision(&proposed.release).await?;
        if decision.is_none_or(|decision| decision.verdict == Verdict::Promoted) {
            return Ok(Some(proposed));
        }
    }
    let of_candidate = proposed.release.map.version;
    Ok(newest.map(|mut live| {
        // The candidate itself, or a release that came after it, is known by its own version.
        let version = &mut live.release.map.version;
        if *version < of_candidate {
            *version = of_candidate.saturating_add(1);
        }
        live
    }))
}

/// The version of the next release, live or not: beyond those of all others, and of what [`newest_with_candidates`] serves after a
/// candidate that was rejected or overtaken.
pub(crate) async fn next_version(
    store: &ReleaseStore,
    newest: Option<&Release>,
) -> Result<u64, ReleaseError> {
    let live = newest.map_or(0, |newest| newest.map.version);
    let mut proposed = 0;
    for number in store.candidate_numbers().await?.into_iter().rev() {
        match store.candidate(number).await {
            Ok(candidate) => {
                proposed = candidate.map.version.saturating_add(1);
                break;
            }
            Err(error @ ReleaseError::Store { .. }) => return Err(error),
            // Nobody can serve it.
            Err(error) => tracing::warn!("a candidate is passed over: {}", with_causes(&error)),
        }
    }
    Ok(live.max(proposed).saturating_add(1))
}

/// Whether a candidate would come right after the newest release.
fn ensure_next(newest: Option<&Release>, proposed: &Release, candidate: u64) -> Result<(), ReleaseError> {
    let (newest, version) = newest.map_or((0, 0), |newest| (newest.number, newest.map.version));
    if proposed.number == newest + 1 && proposed.map.version > version {
        return Ok(());
    }
    Err(ReleaseError::Overtaken { candidate, number: proposed.number, newest })
}

/// Puts a decision, or returns the one that was put before.
async fn decide(
    store: &ReleaseStore,
    proposed: &Release,
    candidate: u64,
    verdict: Verdict,
    note: &Note,
) -> Result<Decision, ReleaseError> {
    let decision = Decision {
        candidate,
        digest: proposed.digest,
        verdict,
        decided_unix_s: now_unix_s(),
        note: note.clone(),
    };
    if store.put_decision(&decision).await? {
        return Ok(decision);
    }
    let former = store.decision(proposed).await?;
    former.ok_or_else(|| ReleaseError::CandidateConflict { candidate })
}

/// Whether the live release of a candidate's number is that candidate; one that was cleaned away counts as it.
async fn is_promoted(store: &ReleaseStore, proposed: &Release) -> Result<bool, ReleaseError> {
    match store.release(proposed.number).await {
        Ok(live) => Ok(live.candidate == proposed.candidate),
        Err(ReleaseError::NoRelease { .. }) => Ok(true),
        Err(error) => Err(error),
    }
}

fn decided(decision: Decision) -> ReleaseError {
    let Decision { candidate, verdict, note, .. } = decision;
    ReleaseError::Decided { candidate, verdict, by: note.author }
}
