//! Writes the files of a run.

use super::files::{OutputError, OutputFiles};
use super::summary::Summary;
use evaluation::trajectory::StateRow;
use robot::{Estimate, Event, Output};
use std::path::Path;

/// The files of a run. Lent to a run as an [`Output`], they are finished afterwards.
#[derive(Debug)]
pub struct Recorder {
    files: OutputFiles,
    /// The newest state, not written yet: map updates after the frame replace it.
    newest: Option<StateRow>,
    /// The first error of writing; the files are incomplete then.
    error: Option<OutputError>,
}

impl Recorder {
    /// Creates the output folder and its files.
    ///
    /// # Arguments
    /// * `limit`: bytes of all files together, with which those of an earlier run are kept and old ones are not; `None` without one.
    ///
    /// # Errors
    /// [`OutputError`] with the file.
    pub fn create(folder: &Path, limit: Option<u64>) -> Result<Self, OutputError> {
        Ok(Self { files: OutputFiles::create(folder, limit)?, newest: None, error: None })
    }

    fn write_newest(&mut self) {
        if let Some(row) = self.newest.take() {
            let written = self.files.append_state(&row);
            self.keep_first_error(written);
        }
    }

    /// A run continues when its disk is full: the first error is logged, and reported at the end.
    fn keep_first_error(&mut self, written: Result<(), OutputError>) {
        if let (Err(error), None) = (written, &self.error) {
            tracing::error!(%error, "the output files will be incomplete; the run continues");
            self.error = Some(error);
        }
    }

    /// Whether the files have the last part of the run only, for the limit of the folder.
    pub fn is_cut(&self) -> bool {
        self.files.is_cut()
    }

    /// Writes the last state and flushes the files.
    ///
    /// # Errors
    /// The first [`OutputError`] of the run.
    pub fn finish_states(&mut self) -> Result<(), OutputError> {
        self.write_newest();
        self.error.take().map_or_else(|| self.files.flush(), Err)
    }

    /// Writes the summary.
    ///
    /// # Errors
    /// [`OutputError`] with the file.
    pub fn write_summary(&self, summary: &Summary) -> Result<(), OutputError> {
        self.files.write_summary(summary)
    }
}

impl Output for Recorder {
    fn estimate(&mut self, estimate: &Estimate) {
        self.write_newest();
        self.revise(estimate);
    }

    fn revise(&mut self, estimate: &Estimate) {
        self.newest = Some(StateRow {
            stamp_ns: estimate.motion.stamp_ns,
            local_from_imu: estimate.motion.local_from_imu(),
            global_from_local: estimate.trusted().map(|global| global.global_from_local),
            global_from_imu: estimate.trusted().map(|global| global.global_from_imu),
        });
    }

    fn query(&mut self, event: &Event) {
        let written = self.files.append_event(event);
        self.keep_first_error(written);
    }
}
