//! The result of each query.

use super::canvas::{self, BAD, ESTIMATE, GOOD, Mark, ODOMETRY, TRUTH, entry};
use super::error::PlotError;
use super::events::QueryEvent;
use super::panel::{Dots, Needles, Panel};
use super::run_files::RunFiles;
use plotters::style::RGBColor;
use std::path::{Path, PathBuf};

/// Draws reprojection errors, matches and inliers of all queries.
pub(crate) fn draw(run: &RunFiles, events: &[QueryEvent], path: &Path) -> Result<PathBuf, PlotError> {
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

fn errors(run: &RunFiles, events: &[QueryEvent]) -> Panel {
    let chosen = |wanted: &dyn Fn(&QueryEvent) -> bool, colour: RGBColor| {
        let events = events.iter().filter(|event| wanted(event));
        let points =
            events.filter_map(|event| Some((run.seconds(event.stamp_ns), event.mean_reprojection_px?)));
        Dots { points: points.collect(), colour, radius: 3 }
    };
    let dots = vec![
        chosen(&|event| event.accepted && !event.relinearized, GOOD),
        chosen(&|event| event.accepted && event.relinearized, ODOMETRY),
        chosen(&|event| !event.accepted, BAD),
    ];
    let highest = dots.iter().flat_map(|dots| &dots.points).map(|point| point.1).fold(1.0, f64::max);
    Panel {
        x_label: "",
        y_label: "mean reprojection error [px]".to_owned(),
        x: 0.0..run.duration(),
        y: 0.0..highest * 1.08,
        dots,
        ..Panel::default()
    }
}

fn counts(run: &RunFiles, events: &[QueryEvent]) -> Panel {
    let needles = |count: &dyn Fn(&QueryEvent) -> usize, colour: RGBColor, width: u32| {
        let points = events.iter().map(|event| (run.seconds(event.stamp_ns), count(event) as f64));
        Needles { points: points.filter(|point| point.1 > 0.0).collect(), colour, width }
    };
    let highest = events.iter().map(|event| event.matches).max().unwrap_or(0).max(1) as f64;
    Panel {
        x_label: "time of the image [s]",
        y_label: "matches, inliers".to_owned(),
        x: 0.0..run.duration(),
        y: 0.0..highest * 1.08,
        needles: vec![
            needles(&|event| event.matches, TRUTH, 2),
            needles(&|event| event.inliers, ESTIMATE, 2),
        ],
        ..Panel::default()
    }
}
