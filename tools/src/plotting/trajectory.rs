//! Plan view of a run.

use super::canvas::{self, Area, BAD, ESTIMATE, GOOD, LegendEntry, MAP, Mark, ODOMETRY, TRUTH, entry};
use super::panel::{Panel, Series, inner_size};
use super::run_files::RunFiles;
use super::series::{range, thin_path};
use evaluation::trajectory::StateKind;
use geometry::pose::Pose;
use nalgebra::{UnitQuaternion, Vector3};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Projection along gravity.
pub(crate) struct PlanView {
    /// Rotates gravity to -z.
    level: UnitQuaternion<f64>,
}

impl PlanView {
    /// For a frame with gravity along `gravity`.
    pub(crate) fn along(gravity: &Vector3<f64>) -> Self {
        let half_turn = || UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        Self { level: UnitQuaternion::rotation_between(gravity, &-Vector3::z()).unwrap_or_else(half_turn) }
    }

    /// A position in the plan: x, y.
    pub(crate) fn project(&self, position: &Vector3<f64>) -> (f64, f64) {
        let seen = self.level * position;
        (seen.x, seen.y)
    }

    /// A position in the plan, and its height.
    pub(crate) fn project_with_height(&self, position: &Vector3<f64>) -> [f64; 3] {
        (self.level * position).into()
    }
}

/// Draws the plan view of a run.
pub(crate) fn draw(run: &RunFiles, path: &Path) -> anyhow::Result<PathBuf> {
    let gravity = run.truth.as_ref().map_or_else(|| -Vector3::z(), |truth| truth.gravity);
    let view = PlanView::along(&gravity);
    let mut legend = Vec::new();
    let mut series = Vec::new();
    if !run.keyframes.is_empty() {
        legend.push(entry(Mark::Dot, MAP, "keyframes of the map"));
    }
    add_truth(run, &view, &mut series, &mut legend);
    add_local(run, &view, &mut series, &mut legend);
    add_pose(run, &view, &mut series, &mut legend);
    let keyframes = run.keyframes.iter().map(|position| view.project(position));
    series.push(Series::dots(keyframes.collect(), MAP, 3));
    add_queries(run, &view, &mut series, &mut legend);
    let title = format!("{} \u{2013} plan view", run.name);
    canvas::draw(path, (1000, 900), &title, &legend, |body| plan(body, series))
}

/// A plan with the same scale along both axes.
pub(crate) fn plan(area: &Area<'_>, series: Vec<Series>) -> anyhow::Result<()> {
    let points = || series.iter().flat_map(|series| series.points.iter());
    let (x, y) = same_scale(
        range(points().map(|point| point.0)),
        range(points().map(|point| point.1)),
        inner_size(area),
    );
    let panel = Panel { x_label: "x [m]", y_label: "y [m]".to_owned(), x, y, series, ..Panel::default() };
    panel.draw(area)
}

/// Widens one of two ranges so that a metre is as long on both axes.
fn same_scale(x: Range<f64>, y: Range<f64>, (width, height): (f64, f64)) -> (Range<f64>, Range<f64>) {
    let metres_a_pixel = ((x.end - x.start) / width).max((y.end - y.start) / height);
    let widened = |range: Range<f64>, pixels: f64| {
        let (middle, half) = (f64::midpoint(range.start, range.end), metres_a_pixel * pixels / 2.0);
        middle - half..middle + half
    };
    (widened(x, width), widened(y, height))
}

fn add_truth(run: &RunFiles, view: &PlanView, series: &mut Vec<Series>, legend: &mut Vec<LegendEntry>) {
    let points: Vec<_> = run.truth_rows().iter().map(|row| view.project(&row.pose.translation)).collect();
    if !points.is_empty() {
        series.push(Series::line(thin_path(&points), TRUTH, 4));
        legend.push(entry(Mark::Line, TRUTH, "truth"));
    }
}

/// The local pose, with L at its true pose, or else at the last estimate of it.
fn add_local(run: &RunFiles, view: &PlanView, series: &mut Vec<Series>, legend: &mut Vec<LegendEntry>) {
    let true_pose = run.errors().and_then(Result::ok).map(|errors| errors.true_global_from_local);
    let last_estimate =
        || run.states.iter().rev().find_map(|state| state.global_from_local.as_ref()).map(|state| state.pose);
    let (global_from_local, label) = match true_pose {
        Some(pose) => (pose, "local pose, with L at its true pose"),
        None => match last_estimate() {
            Some(pose) => (pose, "local pose, with L at its last estimate"),
            None => (Pose::identity(), "local pose in L"),
        },
    };
    let at = |state: &evaluation::trajectory::StateRow| {
        global_from_local.transform(&state.local_from_imu.pose.translation)
    };
    let points: Vec<_> = run.states.iter().map(|state| view.project(&at(state))).collect();
    series.push(Series::line(thin_path(&points), ODOMETRY, 2));
    legend.push(entry(Mark::Line, ODOMETRY, label));
}

fn add_pose(run: &RunFiles, view: &PlanView, series: &mut Vec<Series>, legend: &mut Vec<LegendEntry>) {
    let poses = run.states.iter().filter_map(|state| state.get(StateKind::GlobalFromImu));
    let points: Vec<_> = poses.map(|state| view.project(&state.pose.translation)).collect();
    if !points.is_empty() {
        series.push(Series::line(thin_path(&points), ESTIMATE, 2));
        legend.push(entry(Mark::Line, ESTIMATE, "pose in G"));
    }
}

/// Positions of queries whose match was used, and of those whose match was rejected.
fn add_queries(run: &RunFiles, view: &PlanView, series: &mut Vec<Series>, legend: &mut Vec<LegendEntry>) {
    let matched = run.events.iter().flatten().filter(|event| event.matches > 0);
    let (mut good, mut bad) = (Vec::new(), Vec::new());
    for event in matched {
        let state = run.states.binary_search_by_key(&event.stamp_ns, |state| state.stamp_ns).ok();
        let Some(pose) = state.and_then(|index| run.states[index].global_from_imu.as_ref()) else { continue };
        let list = if event.accepted { &mut good } else { &mut bad };
        list.push(view.project(&pose.pose.translation));
    }
    for (points, colour, label) in [(good, GOOD, "match used"), (bad, BAD, "match rejected")] {
        if !points.is_empty() {
            series.push(Series::dots(points, colour, 3));
            legend.push(entry(Mark::Dot, colour, label));
        }
    }
}
