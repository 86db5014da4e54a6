//! Plots of a run, as SVG without fonts of the system.
//!
//! | plot | shows |
//! |---|---|
//! | `trajectory.svg` | plan view: ground truth, pose in G, local pose, keyframes of the map, matches used and rejected |
//! | `over_time.svg` | position along each axis over time |
//! | `error_local.svg`, `error_transform.svg`, `error_pose.svg` | the six errors with the 3-sigma bounds of the filter's covariance |
//! | `reprojection.svg` | queries: reprojection error, matches, inliers, used or rejected |
//! | coverage of a map | plan view of keyframes and landmarks ([`draw_coverage`]) |
//! | matches of an image | query and keyframe, inliers, outliers, errors ([`draw_matches`]) |
//! | NEES of an ensemble over time, with bounds | one line a filter ([`draw_ensemble`]) |
//! | `comparison.svg` | several runs: trajectories, errors and claimed uncertainty ([`comparison`]) |
//!
//! Over time, grey bands show where the map gave nothing, and dots which answers were used or refused. [`draw_png`] makes pixels of
//! any of them.
//!
//! Without ground truth there are no errors to draw, and [`Drawn::missing`] says so.

mod canvas;
pub mod comparison;
mod coverage;
mod ensemble;
mod errors;
mod font;
mod map_use;
mod match_statistics;
mod matches;
mod over_time;
mod panel;
#[cfg(feature = "png")]
mod png;
#[cfg(not(feature = "png"))]
#[path = "no_png.rs"]
mod png;
mod reprojection;
mod run_files;
mod series;
mod trajectory;

#[cfg(test)]
mod tests;

pub use coverage::draw_coverage;
pub use ensemble::{EnsembleLine, draw_ensemble};
pub use match_statistics::describe_verdict;
pub use matches::{MatchPicture, draw_matches};
pub use png::draw_png;
pub use run_files::{RunFiles, Truth, read_keyframes};

use anyhow::Context as _;
use canvas::not_written;
use evaluation::trajectory::StateKind;
use std::path::{Path, PathBuf};

/// What was drawn, and what was not.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Drawn {
    /// The plots.
    pub pictures: Vec<PathBuf>,
    /// What is missing, and why; whole sentences.
    pub missing: Vec<String>,
}

/// Draws all plots of a run for which its files have the data.
///
/// # Errors
/// A plot cannot be written.
pub fn draw_run(run: &RunFiles, out: &Path) -> anyhow::Result<Drawn> {
    std::fs::create_dir_all(out).with_context(|| not_written(out))?;
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
            drawn.missing.push("The run has no queries, so there are no reprojection errors.".to_owned());
        }
        None => {}
    }
    Ok(drawn)
}
