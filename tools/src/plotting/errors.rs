//! The six errors of one pose over time, with the bounds of the filter's covariance.

use super::canvas::{self, BAND, ESTIMATE, GRID, Mark, entry};
use super::map_use::MapUse;
use super::panel::{Panel, Series, Shape};
use super::run_files::RunFiles;
use super::series::{quantile, thin};
use evaluation::ErrorSample;
use evaluation::trajectory::StateKind;
use std::path::{Path, PathBuf};

/// Bounds are drawn at so many standard deviations.
const BOUND: f64 = 3.0;
/// Quantile of the bounds that the axis shows: the first ones after a start are too wide for one scale.
const SHOWN_BOUNDS: f64 = 0.97;

/// Draws the errors of one pose.
pub(crate) fn draw(
    run: &RunFiles,
    kind: StateKind,
    samples: &[ErrorSample],
    path: &Path,
) -> anyhow::Result<PathBuf> {
    let map_use = MapUse::of(run);
    let mut legend = vec![
        entry(Mark::Line, ESTIMATE, "error (truth minus estimate)"),
        entry(Mark::Patch, BAND, "3 standard deviations, by the filter"),
    ];
    legend.extend(map_use.legend());
    canvas::draw(path, (1120, 860), &title(run, kind), &legend, |body| {
        for (index, area) in body.split_evenly((3, 2)).iter().enumerate() {
            // Rotation on the left, position on the right; x, y, z downwards.
            let (axis, is_position) = (index / 2, index % 2 == 1);
            panel(run, samples, &map_use, (axis, is_position), index >= 4).draw(area)?;
        }
        Ok(())
    })
}

fn panel(
    run: &RunFiles,
    samples: &[ErrorSample],
    map_use: &MapUse,
    (axis, is_position): (usize, bool),
    is_last: bool,
) -> Panel {
    let (column, scale) = if is_position { (axis + 3, 1.0) } else { (axis, 1f64.to_degrees()) };
    let line = |value: &dyn Fn(&ErrorSample) -> f64| -> Vec<(f64, f64)> {
        samples.iter().map(|sample| (run.seconds(sample.stamp_ns), value(sample) * scale)).collect()
    };
    let errors = line(&|sample| sample.error[column]);
    let bounds = line(&|sample| BOUND * sample.sigma[column]);
    let largest = errors.iter().map(|(_, error)| error.abs()).fold(0.0, f64::max);
    let widest = quantile(bounds.iter().map(|(_, bound)| *bound), SHOWN_BOUNDS).unwrap_or(0.0);
    let height = 1.08 * largest.max(widest).max(1e-9);
    let letter = ["x", "y", "z"][axis];
    let y = -height..height;
    let band = Series { points: thin(&bounds), colour: BAND, shape: Shape::Band };
    let zero = Series::line(vec![(0.0, 0.0), (run.duration(), 0.0)], GRID, 1);
    let error = Series::line(thin(&errors), ESTIMATE, 1);
    let marks = map_use.marks(&y);
    Panel {
        x_label: if is_last { "time [s]" } else { "" },
        y_label: if is_position {
            format!("position {letter} [m]")
        } else {
            format!("rotation {letter} [deg]")
        },
        x: 0.0..run.duration(),
        y,
        series: map_use.bands().chain([band, zero, error]).chain(marks).collect(),
        ..Panel::default()
    }
}

/// The title, with the figures of the run's summary.
fn title(run: &RunFiles, kind: StateKind) -> String {
    let (what, score) = match kind {
        StateKind::LocalFromImu => ("local pose (IMU in L)", run.score().map(|score| score.local)),
        StateKind::GlobalFromLocal => ("transform (L in G)", run.score().and_then(|score| score.transform)),
        StateKind::GlobalFromImu if run.truth_is_aligned => {
            ("pose in G, aligned in yaw and position", run.score().and_then(|score| score.pose))
        }
        StateKind::GlobalFromImu => ("pose in G, not aligned", run.score().and_then(|score| score.pose)),
    };
    let figures = score.map_or_else(String::new, |score| {
        let nees = score.nees_pose.map_or_else(String::new, |nees| format!(", NEES {nees:.2}"));
        format!(": RMSE {:.3} deg, {:.3} m{nees}", score.rmse_deg, score.rmse_m)
    });
    format!("{} \u{2013} {what}{figures}", run.name)
}
