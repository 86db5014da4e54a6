//! The plots of the demo, all of the first seed.

use super::TownsDemo;
use super::town::Town;
use crate::demo::GRAVITY_IN_GLOBAL;
use crate::demo::robot::Run;
use crate::demo::rows::Row;
use crate::plotting::comparison::{ComparedRun, Comparison, draw, stretches_without_features};
use crate::plotting::{RunFiles, Truth, draw_run};
use anyhow::Result;
use std::path::{Path, PathBuf};

/// Variants in the comparison; more could not be told apart.
const COMPARED: [&str; 3] = ["odometry", "mapconst", "MM+R"];
/// The variant whose run is plotted on its own.
const DETAILED: &str = "MM+R";
/// Images with features come once a second; a gap this long or longer is a drop-out.
const DROPOUT_NS: i64 = 3_000_000_000;

/// Draws the comparison, and all plots of the run with the method itself.
pub(super) fn draw_all(town: &Town, runs: &[Run], demo: &TownsDemo, out: &Path) -> Result<Vec<PathBuf>> {
    let truth = Truth { rows: town.truth().to_vec(), gravity: GRAVITY_IN_GLOBAL };
    let mut pictures = vec![draw(&comparison(town, runs, demo, truth.clone()), &out.join("comparison.svg"))?];
    for run in runs.iter().filter(|run| run.variant.name == DETAILED) {
        let mut files = RunFiles::read(&run.folder, None, Some(GRAVITY_IN_GLOBAL))?;
        files.name = format!("demo, {}", run.variant.name);
        files.truth = Some(truth.clone());
        files.keyframes.clone_from(&town.keyframes);
        pictures.extend(draw_run(&files, &run.folder)?.pictures);
    }
    Ok(pictures)
}

fn comparison(town: &Town, runs: &[Run], demo: &TownsDemo, truth: Truth) -> Comparison {
    let compared = runs.iter().zip(&demo.rows).filter(|(run, _)| COMPARED.contains(&run.variant.name));
    Comparison {
        title: format!("A robot in an imperfect map: error, and claimed uncertainty (seed {})", town.seed),
        caption: demo.conditions_text.clone(),
        truth,
        keyframes: town.keyframes.clone(),
        dropouts: stretches_without_features(&town.live.frames, DROPOUT_NS),
        runs: compared
            .map(|(run, row)| ComparedRun {
                name: format!("{} ({})", row.name, row.description),
                figures: figures(row, demo.conditions.seeds),
                poses: run.poses.clone(),
                errors: run.pose_samples().copied().collect(),
            })
            .collect(),
    }
}

/// The figures of a row over all seeds, for the title of its panel.
fn figures(row: &Row, seeds: u64) -> String {
    let Some(pose) = &row.pose else { return String::new() };
    let nees = pose.nees_pose.map_or_else(|| "-".to_owned(), |nees| format!("{nees:.1}"));
    format!("{seeds} seeds: RMSE {:.2} m, claimed sigma {:.2} m, NEES {nees}", pose.rmse_m, pose.sigma_m)
}
