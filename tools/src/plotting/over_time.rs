//! The position along each axis over time.

use super::canvas::{self, ESTIMATE, Mark, ODOMETRY, TRUTH, entry};
use super::map_use::MapUse;
use super::panel::{Panel, Series};
use super::run_files::RunFiles;
use super::series::{range, thin};
use super::trajectory::PlanView;
use evaluation::trajectory::StateKind;
use nalgebra::Vector3;
use std::path::{Path, PathBuf};

/// Draws the position over time: in G where the run localized, in L else.
pub(crate) fn draw(run: &RunFiles, path: &Path) -> anyhow::Result<PathBuf> {
    let localized = run.states.iter().any(|state| state.global_from_imu.is_some());
    let (kind, what, colour) = if localized {
        (StateKind::GlobalFromImu, "pose in G", ESTIMATE)
    } else {
        (StateKind::LocalFromImu, "local pose in L (the run never localized)", ODOMETRY)
    };
    let gravity = run.truth.as_ref().map_or_else(|| -Vector3::z(), |truth| truth.gravity);
    // L is gravity-aligned by definition; G may have any orientation.
    let view = PlanView::along(if localized { &gravity } else { &LOCAL_GRAVITY });
    let estimate: Vec<(f64, [f64; 3])> = run
        .states
        .iter()
        .filter_map(|state| Some((run.seconds(state.stamp_ns), state.get(kind)?)))
        .map(|(time, state)| (time, view.project_with_height(&state.pose.translation)))
        .collect();
    let truth: Vec<(f64, [f64; 3])> = if localized {
        let rows = run.truth_rows().iter();
        rows.map(|row| (run.seconds(row.stamp_ns), view.project_with_height(&row.pose.translation))).collect()
    } else {
        Vec::new()
    };
    let mut legend = vec![entry(Mark::Line, colour, what)];
    if !truth.is_empty() {
        legend.insert(0, entry(Mark::Line, TRUTH, "truth"));
    }
    let map_use = MapUse::of(run);
    legend.extend(map_use.legend());
    canvas::draw(path, (1120, 760), &format!("{} \u{2013} position over time", run.name), &legend, |body| {
        for (axis, area) in body.split_evenly((3, 1)).iter().enumerate() {
            let along = |points: &[(f64, [f64; 3])]| -> Vec<(f64, f64)> {
                points.iter().map(|(time, position)| (*time, position[axis])).collect()
            };
            let (true_line, line) = (along(&truth), along(&estimate));
            let y = range(true_line.iter().chain(&line).map(|point| point.1));
            let lines = [Series::line(thin(&true_line), TRUTH, 4), Series::line(thin(&line), colour, 2)];
            let marks = map_use.marks(&y);
            let panel = Panel {
                x_label: if axis == 2 { "time [s]" } else { "" },
                y_label: format!("{} [m]", ["x", "y", "height"][axis]),
                x: 0.0..run.duration(),
                y,
                series: map_use.bands().chain(lines).chain(marks).collect(),
                ..Panel::default()
            };
            panel.draw(area)?;
        }
        Ok(())
    })
}

const LOCAL_GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -1.0);
