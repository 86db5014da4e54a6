//! `events.csv`: what became of each query.

use super::PlotError;
use serde::Deserialize;
use std::path::Path;

/// One query. Columns that are not listed here are ignored.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct QueryEvent {
    /// Time of the image, nanoseconds.
    pub stamp_ns: i64,
    /// What the server said: `matched`, `no_match`, ..
    pub outcome: String,
    /// Landmarks that were matched.
    pub matches: usize,
    /// Matches that agree on a pose.
    pub inliers: usize,
    /// Mean reprojection error of the matches before the update, px.
    pub mean_reprojection_px: Option<f64>,
    /// Whether the linearization point was moved.
    pub relinearized: bool,
    /// Whether the state was updated.
    pub accepted: bool,
    /// Why not.
    #[serde(default)]
    pub reason: String,
}

/// Reads `events.csv`.
///
/// # Errors
/// [`PlotError::File`] with the line that cannot be understood.
pub fn read_events(path: &Path) -> Result<Vec<QueryEvent>, PlotError> {
    let wrong = |error: csv::Error| PlotError::File { path: path.to_path_buf(), problem: error.to_string() };
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_path(path).map_err(wrong)?;
    reader.deserialize().collect::<Result<_, _>>().map_err(wrong)
}
