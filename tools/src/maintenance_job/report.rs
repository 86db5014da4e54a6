//! What became of the sessions of a night, and of the map.

use std::path::PathBuf;

use maintenance::SessionReport;
use map::MapContents;
use map::sessions::SessionId;
use serde::Serialize;

/// What became of all sessions, and of the map.
#[derive(Debug, Default, Serialize)]
pub struct JobReport {
    /// Those that the map has now.
    pub taken: Vec<TakenSession>,
    /// Those that are not used.
    pub refused: Vec<RefusedSession>,
    /// Those that the map had before.
    pub known: Vec<PassedSession>,
    /// Those in the inbox whose robots asked another map.
    pub other_maps: Vec<PassedSession>,
    /// Those whose times are in doubt; they are used all the same.
    pub doubtful: Vec<DoubtfulSession>,
    /// The map before.
    pub before: Counts,
    /// The map afterwards.
    pub after: Counts,
    /// The version that was written last; none where there was nothing to write.
    pub version: Option<u64>,
    /// Number of the candidate that was published.
    pub candidate: Option<u64>,
    /// Session files that were removed from the inbox, since the map has them.
    pub removed_files: Vec<PathBuf>,
}

/// A session that the map has now.
#[derive(Debug, Serialize)]
pub struct TakenSession {
    /// Where it is.
    pub file: PathBuf,
    /// As in the ledger of the map.
    pub id: SessionId,
    /// Who recorded it.
    pub robot: String,
    /// What it did to the map.
    pub report: SessionReport,
}

/// A session that is not used.
#[derive(Debug, Serialize)]
pub struct RefusedSession {
    /// Where it is.
    pub file: PathBuf,
    /// Who recorded it; `None` where that cannot be read.
    pub robot: Option<String>,
    /// `unreadable`, `clock`, `interrupted`, or as of [`maintenance::Refusal::kind`].
    pub kind: String,
    /// In words.
    pub reason: String,
    /// It was refused before, and not looked at again.
    pub before: bool,
}

/// A session whose times are in doubt.
#[derive(Debug, Serialize)]
pub struct DoubtfulSession {
    /// Where it is.
    pub file: PathBuf,
    /// In words.
    pub reason: String,
}

/// A session that was passed over.
#[derive(Debug, Serialize)]
pub struct PassedSession {
    /// Where it is.
    pub file: PathBuf,
    /// As in the ledger of a map.
    pub id: SessionId,
}

/// What a map consists of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Counts {
    /// Keyframes.
    pub keyframes: usize,
    /// Landmarks.
    pub landmarks: usize,
    /// Sessions in the ledger.
    pub sessions: usize,
}

impl Counts {
    pub(super) fn of(map: &MapContents) -> Counts {
        Counts {
            keyframes: map.keyframes.len(),
            landmarks: map.landmarks.len(),
            sessions: map.info.sessions.len(),
        }
    }
}
