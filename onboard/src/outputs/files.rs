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

use super::summary::Summary;
use evaluation::trajectory::states::StateWriter;
use evaluation::trajectory::tum::TumWriter;
use evaluation::trajectory::{StampedPose, StateKind, StateRow};
use robot::Event;
use sensors::SequenceError;
use std::fs::File;
use std::path::{Path, PathBuf};

/// Name of the file with all states.
pub const STATES: &str = "states.csv";
/// Name of the file with all queries.
pub const EVENTS: &str = "events.csv";
const SUMMARY: &str = "summary.json";

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
    trajectories: [(StateKind, TumWriter); 3],
    states: StateWriter,
    events: csv::Writer<File>,
    flushed_ns: Option<i64>,
}

impl OutputFiles {
    /// Creates the folder and its files. The summary of an earlier run in the same folder is deleted.
    ///
    /// # Errors
    /// [`OutputError`] with the file.
    pub(crate) fn create(folder: &Path) -> Result<Self, OutputError> {
        std::fs::create_dir_all(folder).map_err(|source| io(folder, source))?;
        let summary = folder.join(SUMMARY);
        if summary.exists() {
            std::fs::remove_file(&summary).map_err(|source| io(&summary, source))?;
        }
        let trajectory = |kind, name| TumWriter::create(&folder.join(name)).map(|writer| (kind, writer));
        let events = folder.join(EVENTS);
        Ok(Self {
            folder: folder.to_path_buf(),
            trajectories: [
                trajectory(StateKind::GlobalFromImu, "pose.tum")?,
                trajectory(StateKind::LocalFromImu, "odometry.tum")?,
                trajectory(StateKind::GlobalFromLocal, "transform.tum")?,
            ],
            states: StateWriter::create(&folder.join(STATES))?,
            events: csv::Writer::from_path(&events)
                .map_err(|source| OutputError::Events { path: events.clone(), source })?,
            flushed_ns: None,
        })
    }

    /// Appends the state of a frame.
    ///
    /// # Errors
    /// [`OutputError`] with the file.
    pub(crate) fn append_state(&mut self, row: &StateRow) -> Result<(), OutputError> {
        for (kind, writer) in &mut self.trajectories {
            if let Some(state) = row.get(*kind) {
                writer.append(&StampedPose { stamp_ns: row.stamp_ns, pose: state.pose })?;
            }
        }
        self.states.append(row)?;
        if row.stamp_ns - *self.flushed_ns.get_or_insert(row.stamp_ns) >= FLUSH_NS {
            self.flushed_ns = Some(row.stamp_ns);
            self.flush()?;
        }
        Ok(())
    }

    /// Appends a query.
    ///
    /// # Errors
    /// [`OutputError`] with the file.
    pub(crate) fn append_event(&mut self, event: &Event) -> Result<(), OutputError> {
        let written = self.events.serialize(event);
        written.map_err(|source| OutputError::Events { path: self.folder.join(EVENTS), source })
    }

    /// Flushes all buffers.
    ///
    /// # Errors
    /// [`OutputError`] with the file.
    pub(crate) fn flush(&mut self) -> Result<(), OutputError> {
        self.trajectories.iter_mut().try_for_each(|(_, writer)| writer.flush())?;
        self.states.flush()?;
        let written = self.events.flush();
        written.map_err(|source| io(&self.folder.join(EVENTS), source))
    }

    /// Writes the summary.
    ///
    /// # Errors
    /// [`OutputError`] with the file.
    pub(crate) fn write_summary(&self, summary: &Summary) -> Result<(), OutputError> {
        let path = self.folder.join(SUMMARY);
        let text = serde_json::to_string_pretty(summary)?;
        std::fs::write(&path, text + "\n").map_err(|source| io(&path, source))
    }
}

fn io(path: &Path, source: std::io::Error) -> OutputError {
    OutputError::Io { path: path.to_path_buf(), source }
}
