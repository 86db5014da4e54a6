//! A night's job: the sessions that have come in, worked into a map one after the other, oldest first, and those that lie beyond the map
//! again when it has grown.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::Result;
use hand_in::Session;
use maintenance::{Refusal, SessionReport, Settings, take_session};
use map::MapContents;
use map::sessions::SessionId;
use mapping::{BuildOptions, Stage};
use protocol::MapIdentity;
use sensors::Sequence;
use serde::Serialize;

use crate::refused_sessions::{ComparedMap, RefusedSessions, Verdict};
use crate::session_files;

/// Kind of a refused session that is no session file, or a damaged one.
const UNREADABLE: &str = "unreadable";
/// A session may end so long from now: clocks differ. It may end so long from when it began by the clock of its robot.
const MAX_AHEAD_DAYS: f64 = 1.0;
/// Seconds of a day.
const DAY_S: f64 = 86_400.0;

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
    /// The version that was written; none where there was nothing to write.
    pub version: Option<u64>,
    /// Number of the candidate that was published.
    pub candidate: Option<u64>,
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
    /// `unreadable`, or as of [`maintenance::Refusal::kind`].
    pub kind: String,
    /// In words.
    pub reason: String,
    /// It was refused before, by the same map and settings, and not looked at again.
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
    fn of(map: &MapContents) -> Counts {
        Counts {
            keyframes: map.keyframes.len(),
            landmarks: map.landmarks.len(),
            sessions: map.info.sessions.len(),
        }
    }
}

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
/// * `known`: sessions that were refused before; those that were refused by this map are not looked at again. Afterwards, those that are
///   refused now.
///
/// # Returns
/// The map, unchanged where no session was taken.
///
/// # Errors
/// A path that cannot be read. A session that cannot be used is named in the report, and the others are worked in.
pub fn maintain(
    map: MapContents,
    paths: &[PathBuf],
    inbox: Option<&Path>,
    settings: &Settings,
    known: &mut RefusedSessions,
    watch: &mut dyn Watch,
) -> Result<(MapContents, JobReport)> {
    let report = JobReport { before: Counts::of(&map), ..JobReport::default() };
    let mut job = Job { map: Compared { contents: map, compared: None }, report, settings, known, watch };
    let mut waiting = Vec::new();
    let named = session_files::find(paths)?.into_iter().map(|file| (file, false));
    let inbox = inbox.map(|inbox| session_files::find(&[inbox.to_owned()])).transpose()?;
    for (file, is_of_inbox) in named.chain(inbox.into_iter().flatten().map(|file| (file, true))) {
        let map = &job.map.contents;
        if let Some(id) = known_session(map, &file) {
            job.report.known.push(PassedSession { file, id });
            continue;
        }
        match Waiting::open(&file) {
            Ok(session) if is_of_inbox && session.is_of_other(map) => {
                job.report.other_maps.push(PassedSession { file, id: session.id });
            }
            Ok(session) => {
                if let Some(reason) = session.doubt.clone() {
                    let doubtful = DoubtfulSession { file, reason };
                    job.watch.doubtful(&doubtful);
                    job.report.doubtful.push(doubtful);
                }
                waiting.push(session);
            }
            Err(error) => {
                let (kind, reason) = (UNREADABLE.to_owned(), format!("{error:#}"));
                job.refuse(RefusedSession { file, robot: None, kind, reason, before: false });
            }
        }
    }
    waiting.sort_by_key(|session| (session.begin_ns, session.id));
    let ids: BTreeSet<SessionId> = waiting.iter().map(|session| session.id).collect();
    job.known.retain(|session| ids.contains(&session));
    job.take_all(waiting);
    let Job { map: Compared { contents: map, .. }, mut report, .. } = job;
    report.after = Counts::of(&map);
    Ok((map, report))
}

/// The identity of a session that a map has already. An inbox keeps what was taken from it: it is not decoded again each night.
fn known_session(map: &MapContents, file: &Path) -> Option<SessionId> {
    // An error is that of the session as a whole, too.
    let identity = Session::identify(file).ok()??;
    let id = SessionId::from_bytes(identity.id);
    map.info.sessions.iter().any(|known| known.id == id).then_some(id)
}

/// The work on all sessions.
struct Job<'a> {
    map: Compared,
    report: JobReport,
    settings: &'a Settings,
    known: &'a mut RefusedSessions,
    watch: &'a mut dyn Watch,
}

impl Job<'_> {
    fn refuse(&mut self, refused: RefusedSession) {
        self.watch.refused(&refused);
        self.report.refused.push(refused);
    }

    /// Works sessions in, in this order, and those that were of another place again where the map has grown since, maybe to that place.
    fn take_all(&mut self, mut waiting: Vec<Waiting>) {
        while !waiting.is_empty() {
            let count = waiting.len();
            let mut elsewhere: Vec<(usize, Waiting, RefusedSession)> = Vec::new();
            for (at, session) in waiting.into_iter().enumerate() {
                match self.take(&session, [at + 1, count]) {
                    Ok(taken) => {
                        self.watch.taken(&taken);
                        self.report.taken.push(taken);
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
        self.watch.begin(file, number[0], number[1]);
        let mut sequence =
            Sequence::open(file).map_err(|error| refused(UNREADABLE, error.to_string(), false))?;
        let mut show = |stage, done, all| self.watch.progress(stage, done, all);
        let taken =
            take_session(&mut self.map.contents, &mut sequence, &session.build, self.settings, &mut show);
        match taken {
            Ok(report) => {
                self.map.compared = None;
                Ok(TakenSession { file: file.clone(), id: *id, robot: robot.clone(), report })
            }
            Err(refusal) => {
                let (kind, reason) = (refusal.kind(), refusal.to_string());
                self.known.remember(*id, Verdict::new(kind, reason.clone(), self.map.compared()));
                Err(refused(kind, reason, false))
            }
        }
    }
}

/// A map, with what tells it from others, computed when it is first asked for.
struct Compared {
    contents: MapContents,
    compared: Option<ComparedMap>,
}

impl Compared {
    fn compared(&mut self) -> ComparedMap {
        *self.compared.get_or_insert_with(|| ComparedMap::of(&self.contents))
    }
}

/// A session that the map does not have yet.
struct Waiting {
    file: PathBuf,
    id: SessionId,
    robot: String,
    begin_ns: i64,
    build: BuildOptions,
    /// The maps that its robot asked.
    asked: BTreeSet<MapIdentity>,
    /// Why its times are in doubt.
    doubt: Option<String>,
}

impl Waiting {
    /// Whether its robot asked maps, and this one was none of them.
    fn is_of_other(&self, map: &MapContents) -> bool {
        map.info.identity.is_some_and(|identity| !self.asked.is_empty() && !self.asked.contains(&identity))
    }

    fn open(file: &Path) -> Result<Waiting> {
        let session = Session::open(file)?;
        let so_far = session.recorded.as_ref();
        let Some(recorded) = so_far.map(session_files::recorded) else {
            anyhow::bail!("it was cut off before anything was recorded");
        };
        let now_s = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |elapsed| elapsed.as_secs());
        let ahead_days = (recorded.end_ns as f64 * 1e-9 - now_s as f64) / DAY_S;
        // Everything else in the map would look old.
        anyhow::ensure!(
            ahead_days < MAX_AHEAD_DAYS,
            "it ends {ahead_days:.0} days from now: the clock of robot {} is wrong",
            session.header.robot
        );
        let doubt = clock_doubt(session.header.started_unix_s, recorded.end_ns, &session.header.robot);
        let asked = session.answers.iter().map(|answer| answer.map_identity).collect();
        let robot = session.header.robot;
        let (id, begin_ns) = (recorded.id, recorded.begin_ns);
        let mut build = BuildOptions::default();
        build.robot = Some(robot.clone());
        build.recorded = Some(recorded);
        Ok(Waiting { file: file.to_owned(), id, robot, begin_ns, build, asked, doubt })
    }
}

/// Why the times of a session are in doubt: its images are days from when it began by the clock of its robot.
///
/// # Arguments
/// * `started_unix_s`: when it began, seconds since 1970; 0 where that is not known.
/// * `end_ns`: time of its last image, nanoseconds.
fn clock_doubt(started_unix_s: u64, end_ns: i64, robot: &str) -> Option<String> {
    let days = (end_ns as f64 * 1e-9 - started_unix_s as f64) / DAY_S;
    (started_unix_s > 0 && days.abs() > MAX_AHEAD_DAYS).then(|| {
        let way = if days < 0.0 { "before" } else { "after" };
        format!(
            "its last image is of {:.0} days {way} it began by the clock of robot {robot}: the clock of its cameras was wrong, or a \
             recording was played; the map takes the times of the images for when things were seen",
            days.abs()
        )
    })
}

#[cfg(test)]
mod tests {
    use super::clock_doubt;

    #[test]
    fn times_of_images_that_are_days_from_the_clock_of_the_robot_are_in_doubt() {
        const NOW_S: u64 = 1_750_000_000;
        let end_ns = |s: i64| s * 1_000_000_000;
        let now = NOW_S as i64;
        for fine in [now, now + 80_000, now - 80_000] {
            assert_eq!(clock_doubt(NOW_S, end_ns(fine), "ada"), None);
        }
        let booted_in_1970 = clock_doubt(NOW_S, end_ns(600), "ada").unwrap();
        assert!(
            booted_in_1970.contains("20255 days before") && booted_in_1970.contains("ada"),
            "{booted_in_1970}"
        );
        let ahead = clock_doubt(NOW_S, end_ns(now + 200_000), "ada").unwrap();
        assert!(ahead.contains("2 days after"), "{ahead}");
        // Not known.
        assert_eq!(clock_doubt(0, end_ns(now), "ada"), None);
    }
}
