//! Whether the ledger agrees with the map.

use std::collections::BTreeSet;

use protocol::KeyframeId;

use super::overlap::SessionOverlap;
use super::session::{MAX_TEXT_BYTES, Session, SessionId};
use crate::contents::MapContents;
use crate::model::{Keyframe, MAX_ID, MapMetadata};

/// What is wrong with the ledger of a map.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum LedgerProblem {
    /// The map states no sessions.
    #[error(
        "the map has {keyframes} keyframes and no ledger of its sessions: build it again, or export and import it"
    )]
    NoSessions {
        /// How many keyframes it has.
        keyframes: usize,
    },
    /// A keyframe is in no session.
    #[error("keyframe {keyframe} belongs to no session of the ledger")]
    WithoutSession {
        /// Which keyframe.
        keyframe: KeyframeId,
    },
    /// The ids of a session are not beyond those of the one before.
    #[error("session {session:?} has keyframes {} to {}, which do not follow those of the session before", ids[0], ids[1])]
    Ids {
        /// Name of the session.
        session: String,
        /// First and last.
        ids: [KeyframeId; 2],
    },
    /// The ids of a session are too large.
    #[error("session {session:?} has keyframes up to {last}: ids are at most {MAX_ID}")]
    LargeIds {
        /// Name of the session.
        session: String,
        /// The last one.
        last: KeyframeId,
    },
    /// Two sessions have one id.
    #[error("session {session:?} ({id}) is listed twice")]
    Twice {
        /// Name of the session.
        session: String,
        /// Its id.
        id: SessionId,
    },
    /// A text cannot be one, or samples of readings cannot be, or the noise of its pixels.
    #[error(
        "session {id} has a name, a robot or a program of more than {MAX_TEXT_BYTES} bytes or with control characters, samples of \
         readings that are not in order, or a pixel sigma that is not positive"
    )]
    Unusable {
        /// Its id.
        id: SessionId,
    },
    /// The ledger states another number of keyframes.
    #[error("the ledger states {stated} keyframes of session {session:?}, the map has {found}")]
    Keyframes {
        /// Name of the session.
        session: String,
        /// What the ledger states.
        stated: u64,
        /// What the map has.
        found: u64,
    },
    /// The ledger states another number of observations.
    #[error("the ledger states {stated} observations by session {session:?}, the map has {found}")]
    Observations {
        /// Name of the session.
        session: String,
        /// What the ledger states.
        stated: u64,
        /// What the map has.
        found: u64,
    },
    /// The ledger states another number of observations of landmarks that another session has, too.
    #[error(
        "the ledger states {stated} observations by session {session:?} of other sessions' landmarks, the map has {found}"
    )]
    SeenAgain {
        /// Name of the session.
        session: String,
        /// What the ledger states.
        stated: u64,
        /// What the map has.
        found: u64,
    },
    /// Two sessions have the same readings.
    #[error(transparent)]
    Overlap(#[from] SessionOverlap),
}

impl MapContents {
    /// Checks the ledger against the map: every keyframe has one session, the counts are those of the map, and no two sessions
    /// have the same readings.
    ///
    /// # Returns
    /// All problems; none where the ledger is true.
    ///
    /// # Example
    /// ```
    /// use map::{MapContents, MapMetadata};
    /// use protocol::DescriptorKind;
    ///
    /// let map = MapContents::empty(MapMetadata::new("hall", "example", DescriptorKind::Binary, 32));
    /// assert!(map.audit_sessions().is_empty());
    /// ```
    pub fn audit_sessions(&self) -> Vec<LedgerProblem> {
        let sessions = &self.info.sessions;
        if sessions.is_empty() && !self.keyframes.is_empty() {
            return vec![LedgerProblem::NoSessions { keyframes: self.keyframes.len() }];
        }
        let mut problems: Vec<LedgerProblem> =
            check_ledger(&self.info, &self.keyframes).err().into_iter().collect();
        for (stated, found) in sessions.iter().zip(self.counted_sessions()) {
            let session = || stated.name.clone();
            if stated.keyframes != found.keyframes {
                let (stated, found) = (stated.keyframes, found.keyframes);
                problems.push(LedgerProblem::Keyframes { session: session(), stated, found });
            }
            if stated.observations != found.observations {
                let (stated, found) = (stated.observations, found.observations);
                problems.push(LedgerProblem::Observations { session: session(), stated, found });
            }
            if stated.seen_again != found.seen_again {
                let (stated, found) = (stated.seen_again, found.seen_again);
                problems.push(LedgerProblem::SeenAgain { session: session(), stated, found });
            }
        }
        problems.extend(overlaps(sessions).into_iter().map(Into::into));
        problems
    }
}

/// The sessions that have readings of an earlier one, in the order of the ledger. Only those are compared whose times overlap: a ledger may
/// have a hundred thousand.
fn overlaps(sessions: &[Session]) -> Vec<SessionOverlap> {
    let mut by_begin: Vec<usize> = (0..sessions.len()).collect();
    by_begin.sort_by_key(|at| sessions[*at].begin_ns);
    let mut present: Vec<usize> = Vec::new();
    let mut found: Vec<([usize; 2], SessionOverlap)> = Vec::new();
    for at in by_begin {
        present.retain(|other| sessions[*other].end_ns >= sessions[at].begin_ns);
        for other in &present {
            let (earlier, later) = (at.min(*other), at.max(*other));
            found.extend(
                sessions[later].overlap(&sessions[earlier]).map(|overlap| ([later, earlier], overlap)),
            );
        }
        present.push(at);
    }
    found.sort_by_key(|(positions, _)| *positions);
    found.into_iter().map(|(_, overlap)| overlap).collect()
}

/// Checks what holds for the ledger of every map that has one: ids of keyframes ascend from session to session, those of sessions
/// differ, and every keyframe has a session.
pub(crate) fn check_ledger(info: &MapMetadata, keyframes: &[Keyframe]) -> Result<(), LedgerProblem> {
    let mut known = BTreeSet::new();
    let mut last = None;
    for session in &info.sessions {
        let Session { id, name, keyframe_ids: ids, .. } = session;
        if !is_usable(session) {
            return Err(LedgerProblem::Unusable { id: *id });
        }
        if ids[0] > ids[1] || last.is_some_and(|last| last >= ids[0]) {
            return Err(LedgerProblem::Ids { session: name.clone(), ids: *ids });
        }
        if ids[1] > MAX_ID {
            return Err(LedgerProblem::LargeIds { session: name.clone(), last: ids[1] });
        }
        if !known.insert(*id) {
            return Err(LedgerProblem::Twice { session: name.clone(), id: *id });
        }
        last = Some(ids[1]);
    }
    let without = |keyframe: &&Keyframe| info.session_of(keyframe.id).is_none();
    match keyframes.iter().find(without).filter(|_| !info.sessions.is_empty()) {
        Some(keyframe) => Err(LedgerProblem::WithoutSession { keyframe: keyframe.id }),
        None => Ok(()),
    }
}

fn is_usable(session: &Session) -> bool {
    let mut texts = [&session.name, &session.added_by].into_iter().chain(&session.robot);
    texts.all(|text| text.len() <= MAX_TEXT_BYTES && !text.chars().any(char::is_control))
        && session.samples.is_valid()
        && session.begin_ns <= session.end_ns
        && session.sigma_px.is_none_or(|sigma_px| sigma_px.is_finite() && sigma_px > 0.0)
}
