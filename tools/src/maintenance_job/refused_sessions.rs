//! What is remembered of sessions that were not taken: which were refused, of which map and settings, and which the program ended with.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use maintenance::{Refusal, Settings};
use map::sessions::SessionId;
use serde::{Deserialize, Serialize};

use super::compared_map::ComparedMap;

/// A session that contradicts a map, or that cannot be used, is looked at again when this part of the keyframes are others.
const OTHER_KEYFRAMES: f64 = 0.1;

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

    /// Whether it would be the same by another map. A session of another place may be of that one since it has grown; one that contradicts the
    /// map does so until much of that is another one.
    fn holds(&self, map: &ComparedMap) -> bool {
        let lasts = [Refusal::CONTRADICTION, Refusal::UNUSABLE].contains(&self.kind.as_str());
        self.map == *map || lasts && self.map.part_of_others(map) < OTHER_KEYFRAMES
    }
}

/// The sessions that were not taken with some settings.
#[derive(Debug, Serialize, Deserialize)]
pub struct RefusedSessions {
    /// Version of the program and its settings.
    judged_by: String,
    sessions: BTreeMap<SessionId, Verdict>,
    /// How often the work on a session was begun and not ended: the program was killed, or ran out of memory.
    #[serde(default)]
    begun: BTreeMap<SessionId, u32>,
    /// Sessions that were of the future when they were looked at first, with the reason: times do not get right by waiting for them. That holds
    /// with all settings.
    #[serde(default)]
    ahead: BTreeMap<SessionId, String>,
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
        let none = RefusedSessions {
            judged_by: judged_by.clone(),
            sessions: BTreeMap::new(),
            begun: BTreeMap::new(),
            ahead: BTreeMap::new(),
        };
        match serde_json::from_slice::<RefusedSessions>(&text) {
            Ok(stored) if stored.judged_by == judged_by => stored,
            Ok(stored) => RefusedSessions { ahead: stored.ahead, ..none },
            Err(_) => none,
        }
    }

    /// Whether a session was refused, by whatever map.
    pub fn has(&self, session: SessionId) -> bool {
        self.sessions.contains_key(&session)
    }

    /// Why a session was refused, where that holds for this map.
    pub fn verdict(&self, session: SessionId, map: &ComparedMap) -> Option<&Verdict> {
        self.sessions.get(&session).filter(|verdict| verdict.holds(map))
    }

    /// Remembers a verdict.
    pub fn remember(&mut self, session: SessionId, verdict: Verdict) {
        self.sessions.insert(session, verdict);
    }

    /// Notes that the work on a session begins.
    pub fn begin(&mut self, session: SessionId) {
        *self.begun.entry(session).or_default() += 1;
    }

    /// Notes that it has ended.
    pub fn end(&mut self, session: SessionId) {
        self.begun.remove(&session);
    }

    /// How often the work on a session was begun and not ended.
    pub fn begun(&self, session: SessionId) -> u32 {
        self.begun.get(&session).copied().unwrap_or(0)
    }

    /// Why a session was of the future.
    pub fn ahead(&self, session: SessionId) -> Option<&str> {
        self.ahead.get(&session).map(String::as_str)
    }

    /// Remembers that a session is of the future.
    pub fn remember_ahead(&mut self, session: SessionId, reason: String) {
        self.ahead.insert(session, reason);
    }

    /// Forgets the verdicts on all but some sessions. What would be a surprise later is not forgotten by a run on other files.
    pub fn retain(&mut self, sessions: &BTreeSet<SessionId>) {
        self.sessions.retain(|session, _| sessions.contains(session));
    }

    /// Writes them beside a map, and waits until they are on the disk; where there are none, nothing is left there.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&self, map: &Path) -> Result<()> {
        let path = Self::path(map);
        let write = || {
            if self.sessions.is_empty() && self.begun.is_empty() && self.ahead.is_empty() {
                return if path.exists() { std::fs::remove_file(&path) } else { Ok(()) };
            }
            let text = serde_json::to_string_pretty(self)?;
            files::write_whole(&path, text.as_bytes()).map_err(std::io::Error::other)
        };
        write().with_context(|| format!("{} cannot be written", path.display()))
    }
}

#[cfg(test)]
mod tests {
    use map::edit::remove_keyframes;
    use testing::{Place, PlaceOptions};

    use super::*;

    #[test]
    fn a_contradiction_holds_until_a_tenth_of_the_keyframes_are_others() {
        let options = PlaceOptions { keyframes: 60, landmarks: 20, ..PlaceOptions::default() };
        let mut map = Place::new(&options).map;
        let before = ComparedMap::of(&map);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("hall.db");
        let mut refused = RefusedSessions::read(&path, &Settings::default());
        let kinds = [Refusal::OTHER_PLACE, Refusal::CONTRADICTION, Refusal::UNUSABLE];
        let ids = [1, 2, 3].map(|byte| SessionId::from_bytes([byte; 16]));
        for (id, kind) in ids.into_iter().zip(kinds) {
            refused.remember(id, Verdict::new(kind, "because".to_owned(), before.clone()));
        }
        refused.write(&path).unwrap();
        let refused = RefusedSessions::read(&path, &Settings::default());
        let mut holds = |removed: usize| {
            let last: BTreeSet<u64> = map.keyframes.iter().rev().take(removed).map(|of| of.id).collect();
            remove_keyframes(&mut map, &last);
            let now = ComparedMap::of(&map);
            ids.map(|id| refused.verdict(id, &now).is_some())
        };
        assert_eq!(holds(0), [true, true, true]);
        assert_eq!(holds(5), [false, true, true]);
        assert_eq!(holds(1), [false, false, false]);
    }

    #[test]
    fn with_other_settings_only_sessions_of_the_future_stay_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("hall.db");
        let [first, second] = [1, 2].map(|byte| SessionId::from_bytes([byte; 16]));
        let mut refused = RefusedSessions::read(&path, &Settings::default());
        refused.begin(first);
        refused.begin(first);
        refused.remember_ahead(second, "it ends 30 days from now".to_owned());
        refused.write(&path).unwrap();
        let refused = RefusedSessions::read(&path, &Settings::default());
        assert_eq!((refused.begun(first), refused.begun(second)), (2, 0));
        let mut other = Settings::default();
        other.half_life_days = 30.0;
        let mut refused = RefusedSessions::read(&path, &other);
        refused.retain(&BTreeSet::new());
        assert_eq!((refused.begun(first), refused.ahead(second).is_some()), (0, true));
        RefusedSessions::read(&folder.path().join("other.db"), &other).write(&path).unwrap();
        assert!(!RefusedSessions::path(&path).exists());
    }
}
