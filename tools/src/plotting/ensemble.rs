//! The NEES of many runs over time, beside the bounds of a consistent filter.

use super::canvas::{self, BAND, COLOURS, GRID, Mark, entry};
use super::panel::{Panel, Series};
use super::series::{quantile, thin};
use evaluation::TimePoint;
use std::path::{Path, PathBuf};

/// Larger NEES are drawn at this value.
const HIGHEST: f64 = 10.0;

/// One filter: its mean NEES over the runs at each time.
#[derive(Clone, Debug)]
pub struct EnsembleLine {
    /// Its name.
    pub name: String,
    /// The mean over runs, with its interval.
    pub points: Vec<TimePoint>,
}

/// Draws a panel for each output, with a line for each filter.
///
/// # Arguments
/// * `panels`: name of an output, and the filters that have it. Empty ones are left out.
///
/// # Errors
/// The plot cannot be written.
pub fn draw_ensemble(
    path: &Path,
    title: &str,
    panels: &[(&str, Vec<EnsembleLine>)],
) -> anyhow::Result<PathBuf> {
    let has_points = |lines: &[EnsembleLine]| lines.iter().any(|line| !line.points.is_empty());
    let panels: Vec<_> = panels.iter().filter(|(_, lines)| has_points(lines)).collect();
    let mut legend = vec![entry(Mark::Line, BAND, "95 % of a consistent filter")];
    if let Some((_, lines)) = panels.first() {
        legend.extend(lines.iter().enumerate().map(|(k, line)| entry(Mark::Line, colour(k), &line.name)));
    }
    let height = 68 + 260 * panels.len().max(1) as u32;
    canvas::draw(path, (1120, height), title, &legend, |body| {
        for ((name, lines), area) in panels.iter().zip(body.split_evenly((panels.len(), 1))) {
            panel(name, lines).draw(&area)?;
        }
        Ok(())
    })
}

fn colour(line: usize) -> plotters::style::RGBColor {
    COLOURS[line.min(COLOURS.len() - 1)]
}

fn panel(name: &str, lines: &[EnsembleLine]) -> Panel {
    let all = || lines.iter().flat_map(|line| &line.points);
    let end = all().map(|point| point.seconds).fold(1.0, f64::max);
    let usual = quantile(all().map(|point| point.mean), 0.99).unwrap_or(1.0);
    let top = usual.max(all().map(|point| point.interval.1).fold(1.5, f64::max)).min(HIGHEST) * 1.1;
    let curve = |line: &EnsembleLine, value: fn(&TimePoint) -> f64| {
        let points: Vec<(f64, f64)> = line
            .points
            .iter()
            .filter(|point| point.mean.is_finite())
            .map(|point| (point.seconds, value(point).min(top)))
            .collect();
        thin(&points)
    };
    // The longest line has the bounds of all: the filters of a picture have the same runs.
    let longest = lines.iter().max_by_key(|line| line.points.len());
    let mut series = vec![Series::line(vec![(0.0, 1.0), (end, 1.0)], GRID, 2)];
    if let Some(longest) = longest {
        for bound in [(|point| point.interval.0) as fn(&TimePoint) -> f64, |point| point.interval.1] {
            series.push(Series::line(curve(longest, bound), BAND, 3));
        }
    }
    let means = |line: &EnsembleLine| curve(line, |point| point.mean);
    series.extend(lines.iter().enumerate().map(|(k, line)| Series::line(means(line), colour(k), 2)));
    Panel {
        x_label: "time [s]",
        y_label: format!("NEES, {name}"),
        x: 0.0..end,
        y: 0.0..top,
        series,
        ..Panel::default()
    }
}
