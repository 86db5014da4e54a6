//! Two sessions with the same readings.

use std::fmt;

use super::session::{Session, SessionId};
use super::utc_time::utc_time;
use crate::model::MapMetadata;

/// What two sessions share.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SharedReadings {
    /// All that was recorded.
    All,
    /// Some readings of the IMU: one recording is a piece of the other, or both are pieces of a third.
    Some {
        /// Samples of these that both have.
        samples: usize,
    },
}

/// A session has readings of another one.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{name:?} {shared} of session {known}: used twice, it would make the map look more accurate than it is"
)]
pub struct SessionOverlap {
    /// Name of the session.
    pub name: String,
    /// What both have.
    pub shared: SharedReadings,
    /// The other session.
    pub known: Box<KnownSession>,
}

/// A session that a map has already.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KnownSession {
    /// Its id.
    pub id: SessionId,
    /// Name of the recording.
    pub name: String,
    /// The robot that recorded it, where known.
    pub robot: Option<String>,
    /// Its first image (ns).
    pub begin_ns: i64,
    /// Its last image (ns).
    pub end_ns: i64,
    /// When it was added to the map, seconds since 1970; `None` where the map was not stored yet.
    pub added_unix_s: Option<u64>,
}

impl From<&Session> for KnownSession {
    fn from(session: &Session) -> Self {
        let Session { id, name, robot, begin_ns, end_ns, added_unix_s, .. } = session;
        KnownSession {
            id: *id,
            name: name.clone(),
            robot: robot.clone(),
            begin_ns: *begin_ns,
            end_ns: *end_ns,
            added_unix_s: *added_unix_s,
        }
    }
}

impl fmt::Display for KnownSession {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let seconds = self.end_ns.saturating_sub(self.begin_ns) as f64 * 1e-9;
        write!(formatter, "{:?} ({}, {seconds:.1} s from {} ns on, ", self.name, self.id, self.begin_ns)?;
        if let Some(robot) = &self.robot {
            write!(formatter, "by {robot}, ")?;
        }
        match self.added_unix_s {
            Some(unix_s) => write!(formatter, "added {})", utc_time(unix_s)),
            None => formatter.write_str("not stored yet)"),
        }
    }
}

impl fmt::Display for SharedReadings {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            SharedReadings::All => formatter.write_str("is the recording"),
            SharedReadings::Some { .. } => formatter.write_str("has readings of the IMU"),
        }
    }
}

impl Session {
    /// What it shares with another session; `None` where nothing is known to be the same.
    pub fn overlap(&self, known: &Session) -> Option<SessionOverlap> {
        let shared = if self.id == known.id {
            SharedReadings::All
        } else if self.begin_ns > known.end_ns || known.begin_ns > self.end_ns {
            return None;
        } else {
            let samples = self.samples.shared_with(&known.samples);
            Some(SharedReadings::Some { samples }).filter(|_| samples > 0)?
        };
        Some(SessionOverlap { name: self.name.clone(), shared, known: Box::new(known.into()) })
    }
}

impl MapMetadata {
    /// Checks that no session of the ledger has readings of another one.
    ///
    /// # Errors
    /// [`SessionOverlap`] with the first session that has.
    pub fn check_new_session(&self, session: &Session) -> Result<(), SessionOverlap> {
        match self.sessions.iter().find_map(|known| session.overlap(known)) {
            Some(overlap) => Err(overlap),
            None => Ok(()),
        }
    }
}
