//! Several runs over the same recording in one picture: where they went, and how far off they were.

use super::canvas::{self, COLOURS, MAP, Mark, TRUTH, entry, text};
use super::panel::{Dots, Line, Panel};
use super::series::{thin, thin_path};
use super::trajectory::{View, plan};
use super::{PlotError, Truth};
use evaluation::trajectory::StampedPose;
use nalgebra::Vector3;
use plotters::style::RGBColor;
use sensors::{Frame, TruthTrack};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Truth is interpolated between rows that are at most so far apart.
const MAX_TRUTH_GAP_NS: i64 = 250_000_000;

/// One run of a comparison.
#[derive(Clone, Debug)]
pub struct ComparedRun {
    /// What to call it.
    pub name: String,
    /// The IMU in G, in order of time. For plain odometry: laid where L truly lies.
    pub poses: Vec<StampedPose>,
}

/// What is compared.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// Title of the picture.
    pub title: String,
    /// The truth of the recording.
    pub truth: Truth,
    /// Positions of the map's keyframes in G, metres.
    pub keyframes: Vec<Vector3<f64>>,
    /// Stretches without a map, nanoseconds; shaded over time.
    pub dropouts: Vec<Range<i64>>,
    /// The runs, at most four of which can be told apart.
    pub runs: Vec<ComparedRun>,
}

/// The stretches of a recording in which no place could be recognized, nanoseconds.
///
/// # Arguments
/// * `longer_than_ns`: images with features come at intervals; a gap counts only if it is longer.
pub fn stretches_without_features(frames: &[Frame], longer_than_ns: i64) -> Vec<Range<i64>> {
    let with_features = frames.iter().filter(|frame| frame.features.is_some()).map(|frame| frame.stamp_ns);
    let first = frames.first().map(|frame| frame.stamp_ns);
    let last = frames.last().map(|frame| frame.stamp_ns);
    let stamps: Vec<i64> = first.into_iter().chain(with_features).chain(last).collect();
    let gaps = stamps.windows(2).map(|pair| pair[0]..pair[1]);
    gaps.filter(|gap| gap.end - gap.start > longer_than_ns).collect()
}

/// Draws a comparison.
///
/// # Errors
/// [`PlotError::Draw`] where the picture cannot be written.
pub fn draw(comparison: &Comparison, path: &Path) -> Result<PathBuf, PlotError> {
    let view = View::along(&comparison.truth.gravity);
    let mut legend = vec![entry(Mark::Dot, MAP, "keyframes of the map"), entry(Mark::Line, TRUTH, "truth")];
    for (run, colour) in coloured(comparison) {
        legend.push(entry(Mark::Line, colour, &run.name));
    }
    if !comparison.dropouts.is_empty() {
        legend.push(entry(Mark::Patch, SHADE, "no map in sight"));
    }
    canvas::draw(path, (1280, 620), &comparison.title, &legend, |body| {
        let (left, right) = body.split_horizontally(640);
        let keyframes = comparison.keyframes.iter().map(|position| view.look(position)).collect();
        let mut lines = vec![path_line(&view, truth_positions(comparison), TRUTH, 4)];
        for (run, colour) in coloured(comparison) {
            lines.push(path_line(&view, run.poses.iter().map(|pose| pose.pose.translation), colour, 2));
        }
        plan(&left, lines, vec![Dots { points: keyframes, colour: MAP, radius: 3 }])?;
        errors_over_time(comparison).draw(&right).map_err(text)
    })
}

const SHADE: RGBColor = RGBColor(236, 236, 232);

fn coloured(comparison: &Comparison) -> impl Iterator<Item = (&ComparedRun, RGBColor)> {
    comparison.runs.iter().enumerate().map(|(index, run)| (run, COLOURS[index.min(COLOURS.len() - 1)]))
}

fn truth_positions(comparison: &Comparison) -> impl Iterator<Item = Vector3<f64>> + '_ {
    comparison.truth.rows.iter().map(|row| row.pose.translation)
}

fn path_line(
    view: &View,
    positions: impl Iterator<Item = Vector3<f64>>,
    colour: RGBColor,
    width: u32,
) -> Line {
    let points: Vec<_> = positions.map(|position| view.look(&position)).collect();
    Line { points: thin_path(&points), colour, width }
}

/// Distance from the truth over time, one line a run.
fn errors_over_time(comparison: &Comparison) -> Panel {
    let track = TruthTrack::new(&comparison.truth.rows);
    let start_ns = comparison.truth.rows.first().map_or(0, |row| row.stamp_ns);
    let end_ns = comparison.truth.rows.last().map_or(1, |row| row.stamp_ns);
    let seconds = |stamp_ns: i64| (stamp_ns - start_ns) as f64 * 1e-9;
    let lines: Vec<Line> = coloured(comparison)
        .map(|(run, colour)| {
            let error = |pose: &StampedPose| {
                let truth = track.pose(pose.stamp_ns, MAX_TRUTH_GAP_NS)?;
                Some((seconds(pose.stamp_ns), (truth.translation - pose.pose.translation).norm()))
            };
            let points: Vec<_> = run.poses.iter().filter_map(error).collect();
            Line { points: thin(&points), colour, width: 2 }
        })
        .collect();
    let highest = lines.iter().flat_map(|line| &line.points).map(|point| point.1).fold(1e-6, f64::max) * 1.08;
    let shades = comparison.dropouts.iter().map(|stretch| super::panel::Band {
        heights: vec![(seconds(stretch.start), highest), (seconds(stretch.end), highest)],
        colour: SHADE,
    });
    Panel {
        x_label: "time [s]",
        y_label: "distance from the truth [m]".to_owned(),
        x: 0.0..seconds(end_ns).max(1e-3),
        y: 0.0..highest,
        bands: shades.collect(),
        lines,
        ..Panel::default()
    }
}
