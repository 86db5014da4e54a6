//! Pictures of a run, as SVG without fonts of the system.
//!
//! | picture | shows |
//! |---|---|
//! | `trajectory.svg` | truth, pose in G and local pose from above, keyframes of the map, where fixes were accepted |
//! | `over_time.svg` | position along each axis over time |
//! | `error_local.svg`, `error_transform.svg`, `error_pose.svg` | the six errors with the filter's own 3-sigma bounds |
//! | `reprojection.svg` | what each query came to: reprojection error, matches, inliers, accepted or not |
//! | what a map covers | keyframes and landmarks from above ([`draw_coverage`]) |
//! | what of an image matched what of a map | both images, inliers, outliers, errors ([`draw_matches`]) |
//! | NEES of many runs over time, with bounds | one line a filter ([`draw_ensemble`]) |
//! | `comparison.svg` | several runs side by side ([`comparison`]) |
//!
//! Only what is known is drawn: without truth there are no errors, and [`draw_run`] says so.

mod canvas;
pub mod comparison;
mod coverage;
mod ensemble;
mod errors;
mod events;
mod match_statistics;
mod matches;
mod over_time;
mod panel;
mod reprojection;
mod run_files;
mod series;
mod svg;
mod trajectory;

#[cfg(test)]
mod tests;

pub use coverage::draw_coverage;
pub use ensemble::{EnsembleLine, draw_ensemble};
pub use events::{QueryEvent, read_events};
pub use match_statistics::describe_verdict;
pub use matches::{MatchPicture, draw_matches};
pub use run_files::{RunFiles, Truth, read_keyframes};

use evaluation::trajectory::StateKind;
use sensors::SequenceError;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Why a picture could not be drawn.
#[derive(Debug, Error)]
pub enum PlotError {
    /// A file of the run or of its truth cannot be read.
    #[error(transparent)]
    Input(#[from] SequenceError),
    /// A file of the run is not what it should be.
    #[error("{}: {problem}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        problem: String,
    },
    /// A picture cannot be written.
    #[error("the picture {} was not written: {problem}", path.display())]
    Draw {
        /// The picture.
        path: PathBuf,
        /// What the drawing library said.
        problem: String,
    },
}

/// What was drawn, and what was not.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Drawn {
    /// The pictures.
    pub pictures: Vec<PathBuf>,
    /// What is missing, and why; whole sentences.
    pub missing: Vec<String>,
}

/// Draws all pictures of a run that its files allow.
///
/// # Errors
/// [`PlotError`] where a picture cannot be written.
pub fn draw_run(run: &RunFiles, out: &Path) -> Result<Drawn, PlotError> {
    std::fs::create_dir_all(out)
        .map_err(|error| PlotError::Draw { path: out.to_path_buf(), problem: error.to_string() })?;
    let mut drawn = Drawn { pictures: Vec::new(), missing: run.missing.clone() };
    drawn.pictures.push(trajectory::draw(run, &out.join("trajectory.svg"))?);
    drawn.pictures.push(over_time::draw(run, &out.join("over_time.svg"))?);
    match run.errors() {
        Some(Ok(all)) => {
            for (kind, name) in [
                (StateKind::LocalFromImu, "error_local.svg"),
                (StateKind::GlobalFromLocal, "error_transform.svg"),
                (StateKind::GlobalFromImu, "error_pose.svg"),
            ] {
                if all.get(kind).is_empty() {
                    drawn
                        .missing
                        .push(format!("The run never localized, so there is no error of {}.", kind.name()));
                } else {
                    drawn.pictures.push(errors::draw(run, kind, all.get(kind), &out.join(name))?);
                }
            }
        }
        Some(Err(error)) => drawn.missing.push(format!("No errors are drawn: {error}.")),
        None => {}
    }
    match &run.events {
        Some(events) if !events.is_empty() => {
            drawn.pictures.push(reprojection::draw(run, events, &out.join("reprojection.svg"))?);
        }
        Some(_) => {
            drawn.missing.push("The run asked no map, so there are no reprojection errors.".to_owned());
        }
        None => {}
    }
    Ok(drawn)
}
