//! A night's job: the sessions that have come in, worked into a map one after the other, oldest first, and those that lie beyond the map
//! again when it has grown.
//!
//! | module | what |
//! |---|---|
//! | `report` | [`JobReport`]: what became of the sessions |
//! | `waiting` | sessions that the map does not have yet |
//! | `refused_sessions` | [`RefusedSessions`]: what is remembered until the next night |
//! | `compared_map` | [`ComparedMap`]: the map that a session was compared with |
//! | `storage` | [`Storage`]: what is on the disk while the job goes on |
//! | `inbox_files` | [`remove_taken`]: files of sessions that the map has |

mod compared_map;
mod inbox_files;
mod refused_sessions;
mod report;
mod storage;
#[cfg(test)]
mod tests;
mod waiting;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use anyhow::Result;
use maintenance::{Refusal, SessionReport, Settings, take_session};
use map::MapContents;
use map::sessions::SessionId;
use mapping::Stage;
use sensors::Sequence;

use crate::session_files;
pub use compared_map::ComparedMap;
pub use inbox_files::remove_taken;
pub use refused_sessions::{RefusedSessions, Verdict};
pub use report::{Counts, DoubtfulSession, JobReport, PassedSession, RefusedSession, TakenSession};
pub use storage::{MapStorage, Storage};
use waiting::{Waiting, now_unix_s};

/// Kind of a refused session that is no session file, or a damaged one.
const UNREADABLE: &str = "unreadable";
/// Kind of one that was of the future when it was looked at first.
const CLOCK: &str = "clock";
/// Kind of one whose work the program did not come to the end of.
const INTERRUPTED: &str = "interrupted";
/// Times that the work on a session is begun: a program that is killed may have been killed for something else.
const MOST_BEGUN: u32 = 2;

/// Called when the work on a session begins and ends, and with its progress.
pub trait Watch {
    /// The work on one of so many sessions begins.
    fn begin(&mut self, file: &Path, number: usize, of: usize);
    /// How far a stage of it is.
    fn progress(&mut self, stage: Stage, done: usize, all: usize);
    /// The map has it now.
    fn taken(&mut self, session: &TakenSession);
    /// It is not used.
    fn refused(&mut self, session: &RefusedSession);
    /// Its times are in doubt.
    fn doubtful(&mut self, session: &DoubtfulSession);
}

/// Works sessions into a map.
///
/// # Arguments
/// * `paths`: session files, and folders of them.
/// * `inbox`: a folder of a server that may serve other maps, too: sessions whose robots asked another map are passed over.
/// * `known`: sessions that were refused before; those of which that holds are not looked at again. Afterwards, those that are refused now.
/// * `storage`: keeps what was done so far.
///
/// # Returns
/// The map, unchanged where no session was taken.
///
/// # Errors
/// A path that cannot be read, a map that cannot be written. A session that cannot be used is named in the report, and the others are
/// worked in.
pub fn maintain(
    map: MapContents,
    paths: &[PathBuf],
    inbox: Option<&Path>,
    settings: &Settings,
    known: &mut RefusedSessions,
    storage: &mut dyn Storage,
    watch: &mut dyn Watch,
) -> Result<(MapContents, JobReport)> {
    let report = JobReport { before: Counts::of(&map), ..JobReport::default() };
    let mut job =
        Job { map: Compared { contents: map, compared: None }, report, settings, known, storage, watch };
    let waiting = job.sort_out(paths, inbox)?;
    job.take_all(waiting)?;
    let Job { map: Compared { contents: map, .. }, mut report, .. } = job;
    report.after = Counts::of(&map);
    Ok((map, report))
}

/// The work on all sessions.
struct Job<'a> {
    map: Compared,
    report: JobReport,
    settings: &'a Settings,
    known: &'a mut RefusedSessions,
    storage: &'a mut dyn Storage,
    watch: &'a mut dyn Watch,
}

impl Job<'_> {
    fn refuse(&mut self, refused: RefusedSession) {
        self.watch.refused(&refused);
        self.report.refused.push(refused);
    }

    /// The sessions that are to be worked in, oldest first, but at the end those that the program may have ended with.
    fn sort_out(&mut self, paths: &[PathBuf], inbox: Option<&Path>) -> Result<Vec<Waiting>> {
        let (mut waiting, mut ids): (Vec<Waiting>, BTreeSet<SessionId>) = (Vec::new(), BTreeSet::new());
        let named = session_files::find(paths)?.into_iter().map(|file| (file, false));
        let inbox = inbox.map(|inbox| session_files::find(&[inbox.to_owned()])).transpose()?;
        for (file, is_of_inbox) in named.chain(inbox.into_iter().flatten().map(|file| (file, true))) {
            let map = &self.map.contents;
            if let Some(id) = waiting::known_session(map, &file) {
                self.report.known.push(PassedSession { file, id });
                continue;
            }
            match Waiting::open(&file) {
                Ok(session) if is_of_inbox && session.is_of_other(map) => {
                    self.report.other_maps.push(PassedSession { file, id: session.id });
                }
                Ok(session) => {
                    ids.insert(session.id);
                    waiting.extend(self.dated(session));
                }
                Err(error) => {
                    let (kind, reason) = (UNREADABLE.to_owned(), format!("{error:#}"));
                    self.refuse(RefusedSession { file, robot: None, kind, reason, before: false });
                }
            }
        }
        self.known.retain(&ids);
        waiting.sort_by_key(|session| (self.known.begun(session.id), session.begin_ns, session.id));
        Ok(waiting)
    }

    /// A session whose times can be; those that may not be are named.
    fn dated(&mut self, session: Waiting) -> Option<Waiting> {
        let before = self.known.ahead(session.id).map(str::to_owned);
        if let Some(reason) = before.clone().or_else(|| session.ahead.clone()) {
            // Where this computer had no time yet, its clock is the wrong one.
            let stored = self.map.contents.info.sessions.iter().filter_map(|known| known.added_unix_s).max();
            if before.is_none() && stored.is_none_or(|stored_s| stored_s <= now_unix_s()) {
                self.known.remember_ahead(session.id, reason.clone());
            }
            self.refuse(RefusedSession {
                file: session.file,
                robot: Some(session.robot),
                kind: CLOCK.to_owned(),
                reason,
                before: before.is_some(),
            });
            return None;
        }
        if let Some(reason) = session.doubt.clone() {
            let doubtful = DoubtfulSession { file: session.file.clone(), reason };
            self.watch.doubtful(&doubtful);
            self.report.doubtful.push(doubtful);
        }
        Some(session)
    }

    /// Works sessions in, in this order, and those that were of another place again where the map has grown since, maybe to that place.
    fn take_all(&mut self, mut waiting: Vec<Waiting>) -> Result<()> {
        while !waiting.is_empty() {
            let count = waiting.len();
            let mut elsewhere: Vec<(usize, Waiting, RefusedSession)> = Vec::new();
            for (at, session) in waiting.into_iter().enumerate() {
                match self.take(&session, [at + 1, count]) {
                    Ok(taken) => {
                        self.watch.taken(&taken);
                        self.report.taken.push(taken);
                        self.storage.taken(&mut self.map.contents, self.known)?;
                    }
                    Err(refused) if refused.kind == Refusal::OTHER_PLACE => {
                        elsewhere.push((self.report.taken.len(), session, refused));
                    }
                    Err(refused) => self.refuse(refused),
                }
            }
            waiting = Vec::new();
            for (taken_before, session, refused) in elsewhere {
                if self.report.taken.len() > taken_before {
                    waiting.push(session);
                } else {
                    self.refuse(refused);
                }
            }
        }
        Ok(())
    }

    /// Works one session in.
    ///
    /// # Arguments
    /// * `number`: of the session, and of how many.
    fn take(&mut self, session: &Waiting, number: [usize; 2]) -> Result<TakenSession, RefusedSession> {
        let Waiting { file, id, robot, .. } = session;
        let refused = |kind: &str, reason, before| RefusedSession {
            file: file.clone(),
            robot: Some(robot.clone()),
            kind: kind.to_owned(),
            reason,
            before,
        };
        if self.known.has(*id)
            && let Some(verdict) = self.known.verdict(*id, self.map.compared())
        {
            return Err(refused(&verdict.kind, verdict.reason.clone(), true));
        }
        if self.known.begun(*id) >= MOST_BEGUN {
            let reason = format!(
                "the program ended {MOST_BEGUN} times while it worked on it: was it killed, or out of memory? To try it again, remove the file \
                 .refused.json beside the map; to discard it, delete its file"
            );
            return Err(refused(INTERRUPTED, reason, true));
        }
        self.watch.begin(file, number[0], number[1]);
        self.known.begin(*id);
        self.storage.begin(self.known);
        let taken = self.work(session);
        self.known.end(*id);
        match taken {
            Ok(report) => {
                self.map.compared = None;
                Ok(TakenSession { file: file.clone(), id: *id, robot: robot.clone(), report })
            }
            Err(NotTaken::Unreadable(reason)) => Err(refused(UNREADABLE, reason, false)),
            Err(NotTaken::Refused(refusal)) => {
                let (kind, reason) = (refusal.kind(), refusal.to_string());
                self.known.remember(*id, Verdict::new(kind, reason.clone(), self.map.compared().clone()));
                Err(refused(kind, reason, false))
            }
        }
    }

    fn work(&mut self, session: &Waiting) -> Result<SessionReport, NotTaken> {
        let mut sequence =
            Sequence::open(&session.file).map_err(|error| NotTaken::Unreadable(error.to_string()))?;
        let mut show = |stage, done, all| self.watch.progress(stage, done, all);
        take_session(&mut self.map.contents, &mut sequence, &session.build, self.settings, &mut show)
            .map_err(|refusal| NotTaken::Refused(Box::new(refusal)))
    }
}

/// Why a session was not taken.
enum NotTaken {
    Unreadable(String),
    Refused(Box<Refusal>),
}

/// A map, with what tells it from others, computed when it is first asked for.
struct Compared {
    contents: MapContents,
    compared: Option<ComparedMap>,
}

impl Compared {
    fn compared(&mut self) -> &ComparedMap {
        self.compared.get_or_insert_with(|| ComparedMap::of(&self.contents))
    }
}
