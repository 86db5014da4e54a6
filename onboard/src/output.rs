//! The files of a run, written while it goes on.
//!
//! | file | what |
//! |---|---|
//! | `pose.tum`, `odometry.tum`, `transform.tum` | I in G, I in L, `G_T_L` |
//! | `states.csv` | all three with their 6x6 covariances |
//! | `events.csv` | a line a query: when asked, answered, matches, inliers, accepted or why not |
//! | `summary.json` | errors where truth is known, times, bytes, counts; written at the end |
//!
//! What was buffered is written once a second of sensor time, so that a run that is killed leaves what it had. A
//! `summary.json` is there only if the run came to its end.

use super::event::Event;
use super::summary::Summary;
use anyhow::{Context as _, Result};
use evaluation::trajectory::states::StateWriter;
use evaluation::trajectory::tum::TumWriter;
use evaluation::trajectory::{StampedPose, StateKind, StateRow};
use std::fs::File;
use std::path::{Path, PathBuf};

/// Name of the file with all states.
pub const STATES: &str = "states.csv";
/// Name of the file with all queries.
pub const EVENTS: &str = "events.csv";
const SUMMARY: &str = "summary.json";

/// Sensor time after which everything is written, nanoseconds.
const FLUSH_NS: i64 = 1_000_000_000;

/// The output folder of a run.
#[derive(Debug)]
pub struct OutputFiles {
    folder: PathBuf,
    trajectories: [(StateKind, TumWriter); 3],
    states: StateWriter,
    events: csv::Writer<File>,
    flushed_ns: Option<i64>,
}

impl OutputFiles {
    /// Makes the folder and its files. The summary of an earlier run in the same folder is deleted.
    ///
    /// # Errors
    /// A sentence that names the file.
    pub fn create(folder: &Path) -> Result<Self> {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("cannot make the folder {}", folder.display()))?;
        let summary = folder.join(SUMMARY);
        if summary.exists() {
            std::fs::remove_file(&summary).with_context(|| format!("cannot delete {}", summary.display()))?;
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
                .with_context(|| format!("cannot write {}", events.display()))?,
            flushed_ns: None,
        })
    }

    /// Appends the state of a frame.
    ///
    /// # Errors
    /// A sentence that names the file.
    pub fn append_state(&mut self, row: &StateRow) -> Result<()> {
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
    /// A sentence that names the file.
    pub fn append_event(&mut self, event: &Event) -> Result<()> {
        self.events.serialize(event).with_context(|| self.events_failed())
    }

    /// Writes what is buffered.
    ///
    /// # Errors
    /// A sentence that names the file.
    pub fn flush(&mut self) -> Result<()> {
        self.trajectories.iter_mut().try_for_each(|(_, writer)| writer.flush())?;
        self.states.flush()?;
        self.events.flush().with_context(|| self.events_failed())
    }

    fn events_failed(&self) -> String {
        format!("cannot write {}", self.folder.join(EVENTS).display())
    }

    /// Writes the summary.
    ///
    /// # Errors
    /// A sentence that names the file.
    pub fn write_summary(&self, summary: &Summary) -> Result<()> {
        let path = self.folder.join(SUMMARY);
        let text =
            serde_json::to_string_pretty(summary).context("the summary holds a number that JSON cannot")?;
        std::fs::write(&path, text + "\n").with_context(|| format!("cannot write {}", path.display()))
    }
}
