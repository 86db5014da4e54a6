//! The files of a run, written while it goes on.
//!
//! | file | what |
//! |---|---|
//! | `pose.tum`, `odometry.tum`, `transform.tum` | I in G, I in L, `G_T_L` |
//! | `states.csv` | all three with their 6x6 covariances |
//! | `events.csv` | a line for each query: when it was sent, when its answer was applied, matches, inliers, accepted or why not |
//! | `summary.json` | errors where truth is known, times, bytes, counts; written at the end |
//!
//! Buffers are flushed once a second of sensor time: a run that is killed leaves what it had. `summary.json` exists
//! only if the run ended in good order.
//!
//! Times are those of the sensors, jumps of their clock included. Where it is set back, new files begin, so that the rows of one are in order of time.
//!
//! A robot that drives for weeks, or is started again and again, keeps the folder below a limit: what was there before is moved to its
//! folder `earlier`, and so are files that have reached half of the limit.

use super::summary::Summary;
use evaluation::trajectory::states::StateWriter;
use evaluation::trajectory::tum::TumWriter;
use evaluation::trajectory::{StampedPose, StateKind, StateRow};
use robot::Event;
use sensors::SequenceError;
use std::fs::File;
use std::io::BufRead;
use std::path::{Path, PathBuf};

/// Name of the file with all states.
pub const STATES: &str = "states.csv";
/// Name of the file with all queries.
pub const EVENTS: &str = "events.csv";
const SUMMARY: &str = "summary.json";
const TRAJECTORIES: [(StateKind, &str); 3] = [
    (StateKind::GlobalFromImu, "pose.tum"),
    (StateKind::LocalFromImu, "odometry.tum"),
    (StateKind::GlobalFromLocal, "transform.tum"),
];
/// Name of the folder with what was written before.
const EARLIER: &str = "earlier";
/// Begin of the names of folders of files from before the clock was set back.
const SET_BACK: &str = "set_back_";

/// Sensor time between two flushes, nanoseconds.
const FLUSH_NS: i64 = 1_000_000_000;

/// Why the output of a run could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OutputError {
    /// A file or folder.
    #[error("cannot write {}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// A trajectory or the states.
    #[error("cannot write a trajectory: {0}")]
    Trajectory(#[from] SequenceError),
    /// The table of queries.
    #[error("cannot write {}: {source}", path.display())]
    Events {
        /// The file.
        path: PathBuf,
        /// The error of the writer.
        source: csv::Error,
    },
    /// The summary holds a number that JSON cannot represent.
    #[error("the summary cannot be represented as JSON: {0}")]
    Summary(#[from] serde_json::Error),
}

/// The output folder of a run.
#[derive(Debug)]
pub(crate) struct OutputFiles {
    folder: PathBuf,
    /// Of all that is kept, bytes; `None` without one.
    limit: Option<u64>,
    writers: Writers,
    flushed_ns: Option<i64>,
    /// Time of the last state in the files.
    last_ns: Option<i64>,
    /// Whether the first states of the run are among the earlier files, or gone.
    is_cut: bool,
}

#[derive(Debug)]
struct Writers {
    trajectories: [(StateKind, TumWriter); 3],
    states: StateWriter,
    events: csv::Writer<File>,
}

impl OutputFiles {
    /// Creates the folder and its files. The summary of an earlier run in the same folder is deleted; with a limit all that such a run
    /// left is kept, if it had a pose.
    ///
    /// # Arguments
    /// * `limit`: bytes of all that is kept.
    ///
    /// # Errors
    /// [`OutputError`] with the file.
    pub(crate) fn create(folder: &Path, limit: Option<u64>) -> Result<Self, OutputError> {
        std::fs::create_dir_all(folder).map_err(|source| io(folder, source))?;
        if limit.is_some() && has_poses(&folder.join(TRAJECTORIES[1].1)) {
            keep_earlier(folder)?;
        }
        let summary = folder.join(SUMMARY);
        if summary.exists() {
            std::fs::remove_file(&summary).map_err(|source| io(&summary, source))?;
        }
        let writers = Writers::create(folder)?;
        Ok(Self {
            folder: folder.to_path_buf(),
            limit,
            writers,
            flushed_ns: None,
            last_ns: None,
            is_cut: false,
        })
    }

    /// Appends the state of a frame; one that is earlier than the last begins new files.
    ///
    /// # Errors
    /// [`OutputError`] with the file.
    pub(crate) fn append_state(&mut self, row: &StateRow) -> Result<(), OutputError> {
        if self.last_ns.replace(row.stamp_ns).is_some_and(|last_ns| row.stamp_ns < last_ns) {
            self.flush()?;
            set_aside(&self.folder)?;
            self.begin_new_files()?;
            self.flushed_ns = None;
        }
        for (kind, writer) in &mut self.writers.trajectories {
            if let Some(state) = row.get(*kind) {
                writer.append(&StampedPose { stamp_ns: row.stamp_ns, pose: state.pose })?;
            }
        }
        self.writers.states.append(row)?;
        if row.stamp_ns - *self.flushed_ns.get_or_insert(row.stamp_ns) >= FLUSH_NS {
            self.flushed_ns = Some(row.stamp_ns);
            self.flush()?;
            self.keep_below_limit()?;
        }
        Ok(())
    }

    /// Appends a query.
    ///
    /// # Errors
    /// [`OutputError`] with the file.
    pub(crate) fn append_event(&mut self, event: &Event) -> Result<(), OutputError> {
        let written = self.writers.events.serialize(event);
        written.map_err(|source| OutputError::Events { path: self.folder.join(EVENTS), source })
    }

    /// Flushes all buffers.
    ///
    /// # Errors
    /// [`OutputError`] with the file.
    pub(crate) fn flush(&mut self) -> Result<(), OutputError> {
        self.writers.trajectories.iter_mut().try_for_each(|(_, writer)| writer.flush())?;
        self.writers.states.flush()?;
        let written = self.writers.events.flush();
        written.map_err(|source| io(&self.folder.join(EVENTS), source))
    }

    /// Begins new files where these have half of the limit; the other half are the earlier ones.
    fn keep_below_limit(&mut self) -> Result<(), OutputError> {
        let all = || set_backs(&self.folder).chain([self.folder.clone()]).flat_map(|folder| written(&folder));
        if self.limit.is_some_and(|limit| all().map(|path| bytes(&path)).sum::<u64>() >= limit / 2) {
            keep_earlier(&self.folder)?;
            self.begin_new_files()?;
        }
        Ok(())
    }

    fn begin_new_files(&mut self) -> Result<(), OutputError> {
        self.writers = Writers::create(&self.folder)?;
        self.is_cut = true;
        Ok(())
    }

    /// Whether the first states of the run are in other files than the last ones, or gone.
    pub(crate) fn is_cut(&self) -> bool {
        self.is_cut
    }

    /// Writes the summary.
    ///
    /// # Errors
    /// [`OutputError`] with the file.
    pub(crate) fn write_summary(&self, summary: &Summary) -> Result<(), OutputError> {
        let path = self.folder.join(SUMMARY);
        let text = serde_json::to_string_pretty(summary)?;
        files::write_whole(&path, (text + "\n").as_bytes()).map_err(|source| io(&path, source))
    }
}

impl Writers {
    fn create(folder: &Path) -> Result<Self, OutputError> {
        let [global, local, transform] = TRAJECTORIES.map(|(kind, name)| {
            let writer = TumWriter::create(&folder.join(name));
            writer.map(|writer| (kind, writer))
        });
        let events = folder.join(EVENTS);
        Ok(Self {
            trajectories: [global?, local?, transform?],
            states: StateWriter::create(&folder.join(STATES))?,
            events: csv::Writer::from_path(&events)
                .map_err(|source| OutputError::Events { path: events.clone(), source })?,
        })
    }
}

/// The files that grow.
fn written(folder: &Path) -> Vec<PathBuf> {
    let names = TRAJECTORIES.into_iter().map(|(_, name)| name).chain([STATES, EVENTS]);
    names.map(|name| folder.join(name)).collect()
}

/// Whether a trajectory has a pose below its header.
fn has_poses(trajectory: &Path) -> bool {
    let file = File::open(trajectory);
    file.is_ok_and(|file| {
        let lines = std::io::BufReader::new(file).lines().map_while(Result::ok);
        lines.skip_while(|line| line.starts_with('#')).any(|line| !line.is_empty())
    })
}

/// Size of a file; zero where there is none.
fn bytes(path: &Path) -> u64 {
    std::fs::metadata(path).map_or(0, |file| file.len())
}

/// Moves the files of a folder, and what was set aside of them, to its folder of earlier ones, in place of those.
fn keep_earlier(folder: &Path) -> Result<(), OutputError> {
    let earlier = folder.join(EARLIER);
    if earlier.exists() {
        std::fs::remove_dir_all(&earlier).map_err(|source| io(&earlier, source))?;
    }
    move_into(&earlier, written(folder).into_iter().chain([folder.join(SUMMARY)]).chain(set_backs(folder)))
}

/// Moves the files of a folder to one of their own: those behind them begin at an earlier time.
fn set_aside(folder: &Path) -> Result<(), OutputError> {
    move_into(&set_back(folder, 1 + set_backs(folder).count()), written(folder))
}

/// The folders of files from before the clock was set back.
fn set_backs(folder: &Path) -> impl Iterator<Item = PathBuf> {
    (1..).map(|number| set_back(folder, number)).take_while(|part| part.exists())
}

fn set_back(folder: &Path, number: usize) -> PathBuf {
    folder.join(format!("{SET_BACK}{number}"))
}

fn move_into(folder: &Path, paths: impl IntoIterator<Item = PathBuf>) -> Result<(), OutputError> {
    let paths: Vec<PathBuf> = paths.into_iter().filter(|path| path.exists()).collect();
    std::fs::create_dir_all(folder).map_err(|source| io(folder, source))?;
    for path in paths {
        let to = folder.join(path.file_name().unwrap_or_default());
        std::fs::rename(&path, &to).map_err(|source| io(&to, source))?;
    }
    Ok(())
}

fn io(path: &Path, source: std::io::Error) -> OutputError {
    OutputError::Io { path: path.to_path_buf(), source }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::{Pose, PoseWithCovariance};

    fn row(at: i64) -> StateRow {
        let local_from_imu = PoseWithCovariance::exact(Pose::identity());
        StateRow {
            stamp_ns: at * 100_000_000,
            local_from_imu,
            global_from_local: None,
            global_from_imu: None,
        }
    }

    fn all_bytes(folder: &Path) -> u64 {
        let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
        entries.map(|path| if path.is_dir() { all_bytes(&path) } else { bytes(&path) }).sum()
    }

    fn stamps(folder: &Path) -> Vec<i64> {
        let states = evaluation::trajectory::states::StateReader::open(&folder.join(STATES)).unwrap();
        states.map(|row| row.unwrap().stamp_ns / 100_000_000).collect()
    }

    #[test]
    fn a_run_without_an_end_stays_below_its_limit_and_has_the_newest_states() {
        let folder = tempfile::tempdir().unwrap();
        let limit = 200_000;
        let mut files = OutputFiles::create(folder.path(), Some(limit)).unwrap();
        for at in 0..3000 {
            files.append_state(&row(at)).unwrap();
        }
        files.flush().unwrap();
        assert!(files.is_cut());
        // What comes within a second is beyond.
        assert!(
            (limit / 3..limit + 20_000).contains(&all_bytes(folder.path())),
            "{}",
            all_bytes(folder.path())
        );
        let (earlier, newest) = (stamps(&folder.path().join(EARLIER)), stamps(folder.path()));
        assert_eq!(newest.last(), Some(&2999));
        assert_eq!(earlier.last().map(|last| last + 1), newest.first().copied());
    }

    #[test]
    fn what_an_earlier_run_left_is_kept_where_it_had_a_pose() {
        let folder = tempfile::tempdir().unwrap();
        let run = |limit, from: i64| {
            let mut files = OutputFiles::create(folder.path(), limit).unwrap();
            (from..from + 5).for_each(|at| files.append_state(&row(at)).unwrap());
            files.flush().unwrap();
        };
        let started = || drop(OutputFiles::create(folder.path(), Some(1_000_000)).unwrap());
        run(Some(1_000_000), 0);
        started();
        started();
        assert_eq!(stamps(&folder.path().join(EARLIER)), [0, 1, 2, 3, 4]);
        assert_eq!(stamps(folder.path()), [0; 0]);
        run(None, 7);
        run(None, 20);
        assert_eq!(stamps(&folder.path().join(EARLIER)), [0, 1, 2, 3, 4]);
        assert_eq!(stamps(folder.path()), [20, 21, 22, 23, 24]);
    }

    #[test]
    fn a_clock_that_is_set_back_begins_new_files() {
        let folder = tempfile::tempdir().unwrap();
        let mut files = OutputFiles::create(folder.path(), Some(1_000_000)).unwrap();
        files.append_state(&row(7)).unwrap();
        files.flush().unwrap();
        // A run before it is kept.
        let mut files = OutputFiles::create(folder.path(), Some(1_000_000)).unwrap();
        for at in [0, 1, 50, 3, 4, 100, 90] {
            files.append_state(&row(at)).unwrap();
        }
        files.flush().unwrap();
        assert!(files.is_cut());
        let earlier = folder.path().join(EARLIER);
        assert_eq!((stamps(&earlier), stamps(folder.path())), (vec![7], vec![90]));
        assert_eq!(stamps(&set_back(folder.path(), 1)), [0, 1, 50]);
        assert_eq!(stamps(&set_back(folder.path(), 2)), [3, 4, 100]);
        OutputFiles::create(folder.path(), Some(1_000_000)).unwrap();
        assert_eq!((stamps(&set_back(&earlier, 1)), stamps(&earlier)), (vec![0, 1, 50], vec![90]));
        assert!(!set_back(folder.path(), 1).exists());
    }
}
