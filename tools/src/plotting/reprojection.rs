//! The result of each query.

use super::canvas::{self, BAD, ESTIMATE, GOOD, Mark, ODOMETRY, TRUTH, entry};
use super::panel::{Panel, Series, Shape};
use super::run_files::RunFiles;
use onboard::Event;
use plotters::style::RGBColor;
use std::path::{Path, PathBuf};

/// Draws reprojection errors, matches and inliers of all queries.
pub(crate) fn draw(run: &RunFiles, events: &[Event], path: &Path) -> anyhow::Result<PathBuf> {
    let legend = [
        entry(Mark::Dot, GOOD, "used"),
        entry(Mark::Dot, ODOMETRY, "used, re-linearized"),
        entry(Mark::Dot, BAD, "rejected"),
        entry(Mark::Line, ESTIMATE, "inliers"),
        entry(Mark::Line, TRUTH, "matches"),
    ];
    let used = events.iter().filter(|event| event.accepted).count();
    let title = format!("{} \u{2013} {} queries, {used} used", run.name, events.len());
    canvas::draw(path, (1120, 660), &title, &legend, |body| {
        let areas = body.split_evenly((2, 1));
        errors(run, events).draw(&areas[0])?;
        counts(run, events).draw(&areas[1])
    })
}

fn errors(run: &RunFiles, events: &[Event]) -> Panel {
    let chosen = |wanted: &dyn Fn(&Event) -> bool, colour: RGBColor| {
        let events = events.iter().filter(|event| wanted(event));
        let points =
            events.filter_map(|event| Some((run.seconds(event.stamp_ns), event.mean_reprojection_px?)));
        Series::dots(points.collect(), colour, 3)
    };
    let series = vec![
        chosen(&|event| event.accepted && !event.relinearized, GOOD),
        chosen(&|event| event.accepted && event.relinearized, ODOMETRY),
        chosen(&|event| !event.accepted, BAD),
    ];
    let highest = series.iter().flat_map(|series| &series.points).map(|point| point.1).fold(1.0, f64::max);
    Panel {
        x_label: "",
        y_label: "mean reprojection error [px]".to_owned(),
        x: 0.0..run.duration(),
        y: 0.0..highest * 1.08,
        series,
        ..Panel::default()
    }
}

fn counts(run: &RunFiles, events: &[Event]) -> Panel {
    let needles = |count: &dyn Fn(&Event) -> usize, colour: RGBColor| {
        let points = events.iter().map(|event| (run.seconds(event.stamp_ns), count(event) as f64));
        Series { points: points.filter(|point| point.1 > 0.0).collect(), colour, shape: Shape::Needles(2) }
    };
    let highest = events.iter().map(|event| event.matches).max().unwrap_or(0).max(1) as f64;
    Panel {
        x_label: "time of the image [s]",
        y_label: "matches, inliers".to_owned(),
        x: 0.0..run.duration(),
        y: 0.0..highest * 1.08,
        series: vec![needles(&|event| event.matches, TRUTH), needles(&|event| event.inliers, ESTIMATE)],
        ..Panel::default()
    }
}
