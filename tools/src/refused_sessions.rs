//! Sessions that were refused, and of which map and settings: they are looked at again when one of these is another one.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use maintenance::Settings;
use map::MapContents;
use map::sessions::SessionId;
use protocol::MapIdentity;
use serde::{Deserialize, Serialize};

/// The map that a session was compared with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ComparedMap {
    digest: MapIdentity,
    /// In its ledger.
    sessions: usize,
}

impl ComparedMap {
    /// Reads all of the map.
    pub fn of(contents: &MapContents) -> ComparedMap {
        ComparedMap { digest: contents.digest(), sessions: contents.info.sessions.len() }
    }
}

/// Why a session was refused.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Verdict {
    /// As of [`maintenance::Refusal::kind`].
    pub kind: String,
    /// In words.
    pub reason: String,
    map: ComparedMap,
}

impl Verdict {
    /// A verdict on a session, by a map.
    pub fn new(kind: &str, reason: String, map: ComparedMap) -> Verdict {
        Verdict { kind: kind.to_owned(), reason, map }
    }
}

/// The sessions that were refused with some settings.
#[derive(Debug, Serialize, Deserialize)]
pub struct RefusedSessions {
    /// Version of the program and its settings.
    judged_by: String,
    sessions: BTreeMap<SessionId, Verdict>,
}

impl RefusedSessions {
    /// Where they are remembered, for a map.
    pub fn path(map: &Path) -> PathBuf {
        let mut path = map.as_os_str().to_owned();
        path.push(".refused.json");
        path.into()
    }

    /// Those of a map, with the same settings and version of the program; none where nothing is remembered, or it cannot be read.
    pub fn read(map: &Path, settings: &Settings) -> RefusedSessions {
        let judged_by = format!("{} {settings:?}", env!("CARGO_PKG_VERSION"));
        let text = files::read(Self::path(map), files::MAX_TEXT_BYTES).unwrap_or_default();
        let stored: Option<RefusedSessions> = serde_json::from_slice(&text).ok();
        let none = || RefusedSessions { judged_by: judged_by.clone(), sessions: BTreeMap::new() };
        stored.filter(|stored| stored.judged_by == judged_by).unwrap_or_else(none)
    }

    /// Whether a session was refused, by whatever map.
    pub fn has(&self, session: SessionId) -> bool {
        self.sessions.contains_key(&session)
    }

    /// Why a session was refused by this map.
    pub fn verdict(&self, session: SessionId, map: ComparedMap) -> Option<&Verdict> {
        self.sessions.get(&session).filter(|verdict| verdict.map == map)
    }

    /// Remembers a verdict.
    pub fn remember(&mut self, session: SessionId, verdict: Verdict) {
        self.sessions.insert(session, verdict);
    }

    /// Forgets the sessions for which a condition does not hold.
    pub fn retain(&mut self, holds: impl Fn(SessionId) -> bool) {
        self.sessions.retain(|session, _| holds(*session));
    }

    /// Writes them beside a map; where there are none, nothing is left there.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&self, map: &Path) -> Result<()> {
        let path = Self::path(map);
        let write = || {
            if self.sessions.is_empty() {
                return if path.exists() { std::fs::remove_file(&path) } else { Ok(()) };
            }
            let text = serde_json::to_string_pretty(self)?;
            files::write_whole(&path, text.as_bytes()).map_err(std::io::Error::other)
        };
        write().with_context(|| format!("{} cannot be written", path.display()))
    }
}
