//! Sessions that came and went between two versions of a map.

use std::collections::BTreeSet;

use serde::Serialize;

use super::session::{Session, SessionId};

/// A session by its names.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct NamedSession {
    /// Its id.
    pub id: SessionId,
    /// Name of the recording.
    pub name: String,
    /// The robot that recorded it, where known.
    pub robot: Option<String>,
    /// Keyframes of it that the map has, or had.
    pub keyframes: u64,
}

/// Which sessions one version has and another one has not.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct SessionDifference {
    /// Those of the second version only.
    pub added: Vec<NamedSession>,
    /// Those of the first version only.
    pub removed: Vec<NamedSession>,
}

impl SessionDifference {
    /// From one ledger to another.
    pub fn between(before: &[Session], now: &[Session]) -> Self {
        let only = |of: &[Session], other: &[Session]| {
            let known: BTreeSet<SessionId> = other.iter().map(|session| session.id).collect();
            let is_new = |session: &&Session| !known.contains(&session.id);
            of.iter().filter(is_new).map(NamedSession::from).collect()
        };
        Self { added: only(now, before), removed: only(before, now) }
    }

    /// Whether both have the same sessions.
    pub fn is_empty(&self) -> bool {
        self.added.is_empty() && self.removed.is_empty()
    }
}

impl From<&Session> for NamedSession {
    fn from(session: &Session) -> Self {
        let Session { id, name, robot, keyframes, .. } = session.clone();
        Self { id, name, robot, keyframes }
    }
}

impl std::fmt::Display for NamedSession {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "{} ({:.8}, {} keyframes", self.name, self.id.to_string(), self.keyframes)?;
        self.robot.iter().try_for_each(|robot| write!(formatter, ", by {robot}"))?;
        formatter.write_str(")")
    }
}
