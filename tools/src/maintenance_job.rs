//! A night's job: the sessions that have come in, worked into a map one after the other, oldest first.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::Result;
use hand_in::Session;
use maintenance::{SessionReport, Settings, take_session};
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
    pub known: Vec<PassedSession>,
    /// Those in the inbox whose robots asked another map.
    pub other_maps: Vec<PassedSession>,
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
    let mut report = JobReport { before: Counts::of(&map), ..JobReport::default() };
    let refuse = |report: &mut JobReport, watch: &mut dyn Watch, refused: RefusedSession| {
        watch.refused(&refused);
        report.refused.push(refused);
    };
    let mut waiting = Vec::new();
    let named = session_files::find(paths)?.into_iter().map(|file| (file, false));
    let inbox = inbox.map(|inbox| session_files::find(&[inbox.to_owned()])).transpose()?;
    for (file, is_of_inbox) in named.chain(inbox.into_iter().flatten().map(|file| (file, true))) {
        match Waiting::open(&file) {
            Ok(session) if map.info.sessions.iter().any(|known| known.id == session.id) => {
                report.known.push(PassedSession { file, id: session.id });
            }
            Ok(session) if is_of_inbox && session.is_of_other(&map) => {
                report.other_maps.push(PassedSession { file, id: session.id });
            }
            Ok(session) => waiting.push(session),
            Err(error) => {
                let (kind, reason) = (UNREADABLE.to_owned(), format!("{error:#}"));
                let refused = RefusedSession { file, robot: None, kind, reason, before: false };
                refuse(&mut report, watch, refused);
            }
        }
    }
    waiting.sort_by_key(|session| (session.begin_ns, session.id));
    let ids: BTreeSet<SessionId> = waiting.iter().map(|session| session.id).collect();
    known.retain(|session| ids.contains(&session));
    let mut map = Compared { contents: map, compared: None };
    let count = waiting.len();
    for (at, session) in waiting.into_iter().enumerate() {
        let refused = |kind: &str, reason, before| RefusedSession {
            file: session.file.clone(),
            robot: Some(session.robot.clone()),
            kind: kind.to_owned(),
            reason,
            before,
        };
        if known.has(session.id)
            && let Some(verdict) = known.verdict(session.id, map.compared())
        {
            let refused = refused(&verdict.kind, verdict.reason.clone(), true);
            refuse(&mut report, watch, refused);
            continue;
        }
        watch.begin(&session.file, at + 1, count);
        let mut sequence = match Sequence::open(&session.file) {
            Ok(sequence) => sequence,
            Err(error) => {
                refuse(&mut report, watch, refused(UNREADABLE, error.to_string(), false));
                continue;
            }
        };
        let mut show = |stage, done, all| watch.progress(stage, done, all);
        match take_session(&mut map.contents, &mut sequence, &session.build, settings, &mut show) {
            Ok(of_session) => {
                map.compared = None;
                let Waiting { file, id, robot, .. } = session;
                let taken = TakenSession { file, id, robot, report: of_session };
                watch.taken(&taken);
                report.taken.push(taken);
            }
            Err(refusal) => {
                let reason = refusal.to_string();
                known.remember(session.id, Verdict::new(refusal.kind(), reason.clone(), map.compared()));
                refuse(&mut report, watch, refused(refusal.kind(), reason, false));
            }
        }
    }
    let map = map.contents;
    report.after = Counts::of(&map);
    Ok((map, report))
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
        let ahead_days = (recorded.end_ns as f64 * 1e-9 - now_s as f64) / 86_400.0;
        // Everything else in the map would look old.
        anyhow::ensure!(
            ahead_days < MAX_AHEAD_DAYS,
            "it ends {ahead_days:.0} days from now: the clock of robot {} is wrong",
            session.header.robot
        );
        let asked = session.answers.iter().map(|answer| answer.map_identity).collect();
        let robot = session.header.robot;
        let (id, begin_ns) = (recorded.id, recorded.begin_ns);
        let mut build = BuildOptions::default();
        build.robot = Some(robot.clone());
        build.recorded = Some(recorded);
        Ok(Waiting { file: file.to_owned(), id, robot, begin_ns, build, asked })
    }
}
