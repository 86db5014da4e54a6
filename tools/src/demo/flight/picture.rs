//! The plots of the demo from pixels, and an image of it.

use super::mapped::MappedRoom;
use super::{FlightDemo, VARIANTS};
use crate::demo::GRAVITY_IN_GLOBAL;
use crate::demo::robot::Run;
use crate::demo::rows::Row;
use crate::plotting::comparison::{ComparedRun, Comparison, draw};
use crate::plotting::{RunFiles, Truth, draw_run};
use anyhow::Result;
use sensors::Sequence;
use std::path::{Path, PathBuf};

/// Draws the comparison and all plots of the run in the map, and writes an image from the middle of the flight.
pub(super) fn draw_all(
    live: &Sequence,
    mapped: &MappedRoom,
    runs: &[Run; VARIANTS.len()],
    demo: &FlightDemo,
    out: &Path,
) -> Result<Vec<PathBuf>> {
    let truth = Truth { rows: live.groundtruth.clone().unwrap_or_default(), gravity: GRAVITY_IN_GLOBAL };
    let compared = |(run, row): (&Run, &Row)| ComparedRun {
        name: format!("{} ({})", row.name, row.description),
        figures: figures(row),
        poses: run.poses.clone(),
        errors: run.pose_samples().copied().collect(),
    };
    let comparison = Comparison {
        title: "A robot localized by its images: error, and claimed uncertainty".to_owned(),
        caption: demo.conditions_text.clone(),
        truth: truth.clone(),
        keyframes: mapped.keyframes.clone(),
        dropouts: Vec::new(),
        runs: runs.iter().zip(&demo.rows).map(compared).collect(),
    };
    let mut pictures = vec![draw(&comparison, &out.join("comparison.svg"))?];
    let [_, in_map] = runs;
    let mut files = RunFiles::read(&in_map.folder, None, Some(GRAVITY_IN_GLOBAL))?;
    files.name = format!("demo, {}", in_map.variant.name);
    files.truth = Some(truth);
    files.keyframes.clone_from(&mapped.keyframes);
    pictures.extend(draw_run(&files, &in_map.folder)?.pictures);
    if let Some(image) = live.frames.get(live.frames.len() / 2).and_then(|frame| frame.images.get(&0)) {
        let path = out.join("image.png");
        image.read()?.write(&path)?;
        pictures.push(path);
    }
    Ok(pictures)
}

/// The figures of a row, for the title of its panel.
fn figures(row: &Row) -> String {
    let Some(pose) = &row.pose else { return "never localized".to_owned() };
    let nees = pose.nees_pose.map_or_else(|| "-".to_owned(), |nees| format!("{nees:.1}"));
    format!("RMSE {:.3} m, claimed sigma {:.3} m, NEES {nees}", pose.rmse_m, pose.sigma_m)
}
