//! Stages of releases: what is live, and what is proposed.
//!
//! A candidate is a release that nobody serves unless told to: it lies beside the live ones, with a number of its own, and states the
//! number that it would have among them. Its file says that it is a candidate, so whoever can write to the store, but cannot
//! sign, cannot make it live by moving it. One decision ends it, and is put only if there is none.

use crate::error::ReleaseError;
use protocol::MapIdentity;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Longest name of an author, bytes.
const MAX_AUTHOR_BYTES: usize = 200;
/// Longest comment, bytes.
const MAX_COMMENT_BYTES: usize = 4000;

/// Where a release stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    /// Servers take the newest of these.
    #[default]
    Live,
    /// It is proposed; servers take it only where they are told to.
    Candidate,
}

impl fmt::Display for Stage {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Live => "live",
            Self::Candidate => "candidate",
        })
    }
}

/// Who did something to a release, and why.
///
/// ```
/// use releases::Note;
///
/// let note = Note::new(Some("ada".to_owned()), Some("racks of aisle 4 moved".to_owned()))?;
/// assert!(Note::new(None, Some("a bell: \u{7}".to_owned())).is_err());
/// # assert_eq!(note.author.as_deref(), Some("ada"));
/// # Ok::<(), releases::ReleaseError>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Note {
    /// Who, as they call themselves: what is certain is the key of the signature.
    pub author: Option<String>,
    /// Why.
    pub comment: Option<String>,
}

impl Note {
    /// # Errors
    /// [`ReleaseError::Note`]: a text that is too long, or has characters that control a terminal.
    pub fn new(author: Option<String>, comment: Option<String>) -> Result<Self, ReleaseError> {
        let note = Self { author, comment };
        note.check().map_err(|(what, at_most)| ReleaseError::Note { what, at_most })?;
        Ok(note)
    }

    /// What is wrong with it: the text's name, and how long it may be.
    pub(crate) fn check(&self) -> Result<(), (&'static str, usize)> {
        let texts =
            [("author", &self.author, MAX_AUTHOR_BYTES), ("comment", &self.comment, MAX_COMMENT_BYTES)];
        for (what, text, at_most) in texts {
            let is_fine = |text: &String| text.len() <= at_most && !text.chars().any(char::is_control);
            if !text.as_ref().is_none_or(is_fine) {
                return Err((what, at_most));
            }
        }
        Ok(())
    }
}

/// What was decided about a candidate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// It becomes the next live release.
    Promoted,
    /// It does not.
    Rejected,
}

impl fmt::Display for Verdict {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Promoted => "promoted",
            Self::Rejected => "rejected",
        })
    }
}

/// The end of a candidate; never changes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Decision {
    /// Number of the candidate.
    pub candidate: u64,
    /// [Digest](map::MapContents::digest) of its map, so that a signed decision is of no other one.
    pub digest: MapIdentity,
    /// What was decided.
    pub verdict: Verdict,
    /// When, seconds since 1970.
    pub decided_unix_s: u64,
    /// By whom, and why.
    pub note: Note,
}

/// What became of a candidate.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "state", rename_all = "snake_case")]
pub enum CandidateState {
    /// Nothing was decided.
    Open,
    /// It was promoted, or that was begun: promoting it again ends what was interrupted.
    Promoted(Decision),
    /// It was rejected.
    Rejected(Decision),
    /// A live release came that it was not compared with.
    Overtaken {
        /// Number of that release.
        by: u64,
    },
}

impl fmt::Display for CandidateState {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Open => formatter.write_str("open"),
            Self::Promoted(_) => formatter.write_str("promoted"),
            Self::Rejected(_) => formatter.write_str("rejected"),
            Self::Overtaken { by } => write!(formatter, "overtaken by release {by}"),
        }
    }
}
