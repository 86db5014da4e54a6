//! `events.csv`: the result of each query.

use super::error::PlotError;
use sensors::read_written_lines;
use serde::Deserialize;
use std::path::Path;

/// One query. Columns that are not listed here are ignored.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct QueryEvent {
    /// Time of the image, nanoseconds.
    pub stamp_ns: i64,
    /// Outcome by the server: `matched`, `no_match`, ..
    pub outcome: String,
    /// Matched landmarks.
    pub matches: usize,
    /// Matches consistent with one pose.
    pub inliers: usize,
    /// Mean reprojection error of the matches before the update, px.
    pub mean_reprojection_px: Option<f64>,
    /// Whether the linearization point was moved.
    pub relinearized: bool,
    /// Whether the state was updated.
    pub accepted: bool,
    /// Reason for a rejection.
    #[serde(default)]
    pub reason: String,
}

/// Reads `events.csv`. A last row that is cut off, as when a run is killed, is left out with a warning.
///
/// # Errors
/// [`PlotError::Events`] with the line that cannot be understood.
pub fn read_events(path: &Path) -> Result<Vec<QueryEvent>, PlotError> {
    let wrong = |source: csv::Error| PlotError::Events { path: path.to_path_buf(), source };
    let lines = read_written_lines(path, "a run writes it to its --out folder")?;
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(lines.text.as_bytes());
    reader.deserialize().collect::<Result<_, _>>().map_err(wrong)
}
