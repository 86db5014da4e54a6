//! Reads a trajectory file of any of the formats, recognized by its first line.

use super::{StampedPose, StateKind, states, tum};
use nalgebra::Matrix6;
use sensors::{SequenceError, read_groundtruth};
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;

/// A trajectory, with covariances where the file has them.
#[derive(Clone, Debug, PartialEq)]
pub struct TrajectoryFile {
    /// The poses, in order of time.
    pub poses: Vec<StampedPose>,
    /// The covariance of each pose (`[dtheta, dp]`, parent frame), from `states.csv`.
    pub covariances: Option<Vec<Matrix6<f64>>>,
}

/// Reads a TUM file, EuRoC ground truth, or one state of a `states.csv`.
///
/// `state` selects a pose of `states.csv`; other formats ignore it.
///
/// # Errors
/// [`SequenceError`] with the file and the line.
pub fn read_any(path: &Path, state: StateKind) -> Result<TrajectoryFile, SequenceError> {
    match first_row(path)? {
        Some(row) if !row.contains(',') => Ok(TrajectoryFile { poses: tum::read(path)?, covariances: None }),
        Some(row) if row.split(',').nth(1).is_some_and(|cell| cell.contains("_from_")) => {
            one_state(path, state)
        }
        _ => {
            let rows = read_groundtruth(path)?;
            let poses =
                rows.iter().map(|row| StampedPose { stamp_ns: row.stamp_ns, pose: row.pose }).collect();
            Ok(TrajectoryFile { poses, covariances: None })
        }
    }
}

fn one_state(path: &Path, state: StateKind) -> Result<TrajectoryFile, SequenceError> {
    let rows = states::read(path)?;
    let chosen = rows.iter().filter_map(|row| row.get(state).map(|pose| (row.stamp_ns, pose)));
    let (poses, covariances): (Vec<_>, Vec<_>) = chosen
        .map(|(stamp_ns, state)| (StampedPose { stamp_ns, pose: state.pose }, state.covariance))
        .unzip();
    if poses.is_empty() {
        let advice = format!("of {}: the run never localized, or choose another state", state.name());
        return Err(SequenceError::empty(path, advice));
    }
    Ok(TrajectoryFile { poses, covariances: Some(covariances) })
}

/// The first line that is neither empty nor a comment.
fn first_row(path: &Path) -> Result<Option<String>, SequenceError> {
    let file = File::open(path).map_err(|source| match source.kind() {
        std::io::ErrorKind::NotFound => SequenceError::missing(path, "a trajectory was expected there"),
        _ => SequenceError::io(path, source),
    })?;
    for line in BufReader::new(file).lines() {
        let line = line.map_err(|source| SequenceError::io(path, source))?;
        if !line.trim().is_empty() && !line.starts_with('#') {
            return Ok(Some(line));
        }
    }
    Ok(None)
}
