//! A night's job: the sessions that have come in, worked into a map one after the other, oldest first.

use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::Result;
use hand_in::Session;
use maintenance::{SessionReport, Settings, take_session};
use map::MapContents;
use map::sessions::SessionId;
use mapping::{BuildOptions, Stage};
use sensors::Sequence;
use serde::Serialize;

use crate::session_files;

/// A session may end so long from now: clocks differ.
const MAX_AHEAD_DAYS: f64 = 1.0;

/// What became of all sessions, and of the map.
#[derive(Debug, Default, Serialize)]
pub struct JobReport {
    /// Those that the map has now.
    pub taken: Vec<TakenSession>,
    /// Those that are not used.
    pub refused: Vec<RefusedSession>,
    /// Those that the map had before.
    pub known: Vec<KnownSession>,
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
    pub kind: &'static str,
    /// In words.
    pub reason: String,
}

/// A session that the map had before.
#[derive(Debug, Serialize)]
pub struct KnownSession {
    /// Where it is.
    pub file: PathBuf,
    /// As in the ledger of the map.
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
}

/// Works sessions into a map.
///
/// # Arguments
/// * `paths`: session files, and folders of them.
///
/// # Returns
/// The map, unchanged where no session was taken.
///
/// # Errors
/// A path that cannot be read. A session that cannot be used is named in the report, and the others are worked in.
pub fn maintain(
    map: &MapContents,
    paths: &[PathBuf],
    settings: &Settings,
    watch: &mut dyn Watch,
) -> Result<(MapContents, JobReport)> {
    let mut report = JobReport { before: Counts::of(map), ..JobReport::default() };
    let refuse = |report: &mut JobReport, watch: &mut dyn Watch, refused: RefusedSession| {
        watch.refused(&refused);
        report.refused.push(refused);
    };
    let mut waiting = Vec::new();
    for file in session_files::find(paths)? {
        match Waiting::open(&file) {
            Ok(session) if map.info.sessions.iter().any(|known| known.id == session.id) => {
                report.known.push(KnownSession { file, id: session.id });
            }
            Ok(session) => waiting.push(session),
            Err(error) => {
                let reason = format!("{error:#}");
                refuse(&mut report, watch, RefusedSession { file, robot: None, kind: "unreadable", reason });
            }
        }
    }
    waiting.sort_by_key(|session| (session.begin_ns, session.id));
    let mut map = map.clone();
    let count = waiting.len();
    for (at, session) in waiting.into_iter().enumerate() {
        watch.begin(&session.file, at + 1, count);
        let refused = |kind, reason| RefusedSession {
            file: session.file.clone(),
            robot: Some(session.robot.clone()),
            kind,
            reason,
        };
        let mut sequence = match Sequence::open(&session.file) {
            Ok(sequence) => sequence,
            Err(error) => {
                refuse(&mut report, watch, refused("unreadable", error.to_string()));
                continue;
            }
        };
        let mut show = |stage, done, all| watch.progress(stage, done, all);
        match take_session(&map, &mut sequence, &session.build, settings, &mut show) {
            Ok((next, of_session)) => {
                map = next;
                let Waiting { file, id, robot, .. } = session;
                let taken = TakenSession { file, id, robot, report: of_session };
                watch.taken(&taken);
                report.taken.push(taken);
            }
            Err(refusal) => {
                refuse(&mut report, watch, refused(refusal.kind(), refusal.to_string()));
            }
        }
    }
    report.after = Counts::of(&map);
    Ok((map, report))
}

/// A session that the map does not have yet.
struct Waiting {
    file: PathBuf,
    id: SessionId,
    robot: String,
    begin_ns: i64,
    build: BuildOptions,
}

impl Waiting {
    fn open(file: &Path) -> Result<Waiting> {
        let session = Session::open(file)?;
        let so_far = session.recorded.as_ref();
        let Some(recorded) = so_far.map(session_files::recorded) else {
            anyhow::bail!("it was cut off before anything was recorded");
        };
        let now_s = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |elapsed| elapsed.as_secs());
        let ahead_days = (recorded.end_ns as f64 * 1e-9 - now_s as f64) / 86_400.0;
        // Everything else in the map would look old.
        anyhow::ensure!(
            ahead_days < MAX_AHEAD_DAYS,
            "it ends {ahead_days:.0} days from now: the clock of robot {} is wrong",
            session.header.robot
        );
        let robot = session.header.robot;
        let (id, begin_ns) = (recorded.id, recorded.begin_ns);
        let mut build = BuildOptions::default();
        build.robot = Some(robot.clone());
        build.recorded = Some(recorded);
        Ok(Waiting { file: file.to_owned(), id, robot, begin_ns, build })
    }
}
