//! Several runs over the same recording in one picture: their trajectories, and their errors beside the uncertainty that
//! they claim.

use super::canvas::{self, Area, BAD, ESTIMATE, GOOD, MAP, Mark, ODOMETRY, SHADE, TRUTH, entry};
use super::panel::{Panel, Series, Shape};
use super::run_files::Truth;
use super::series::{quantile, thin, thin_path};
use super::trajectory::{PlanView, plan};
use evaluation::ErrorSample;
use evaluation::trajectory::StampedPose;
use nalgebra::Vector3;
use plotters::style::RGBColor;
use sensors::{Frame, TruthTrack};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Truth is interpolated between rows that are at most so far apart.
const MAX_TRUTH_GAP_NS: i64 = 250_000_000;
/// Width of the picture, px.
const WIDTH: u32 = 1400;
/// Claimed uncertainty is drawn at so many standard deviations.
const BOUND: f64 = 3.0;
/// One colour a run; a fifth and more share the last.
const RUN_COLOURS: [RGBColor; 4] = [ODOMETRY, BAD, ESTIMATE, GOOD];
/// In the plan, errors are drawn longer by one of these factors.
const EXAGGERATIONS: [f64; 6] = [1.0, 2.0, 5.0, 10.0, 20.0, 50.0];
/// The plan's largest errors come to this fraction of the smaller side of the trajectory.
const EXAGGERATED_SHARE: f64 = 0.15;
/// Quantile of errors and bounds by which the scale is chosen: single outliers may leave the picture.
const SHOWN: f64 = 0.97;

/// One run of a comparison.
#[derive(Clone, Debug)]
pub struct ComparedRun {
    /// What to call it.
    pub name: String,
    /// Its figures, for the title of its panel.
    pub figures: String,
    /// The IMU in G, in order of time. For plain odometry: with L placed where it truly is.
    pub poses: Vec<StampedPose>,
    /// The errors of these poses with the filter's own standard deviations.
    pub errors: Vec<ErrorSample>,
}

/// What is compared.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// Title of the picture.
    pub title: String,
    /// Lines below the title: the conditions.
    pub caption: Vec<String>,
    /// The truth of the recording.
    pub truth: Truth,
    /// Positions of the map's keyframes in G, metres.
    pub keyframes: Vec<Vector3<f64>>,
    /// Stretches without matches, nanoseconds; shaded.
    pub dropouts: Vec<Range<i64>>,
    /// The runs, at most four of which can be told apart.
    pub runs: Vec<ComparedRun>,
}

/// The stretches of a recording in which no image has features, nanoseconds.
///
/// # Arguments
/// * `longer_than_ns`: images with features come at intervals; a gap counts only if it is longer.
pub fn stretches_without_features(frames: &[Frame], longer_than_ns: i64) -> Vec<Range<i64>> {
    let with_features = frames.iter().filter(|frame| !frame.features.is_empty()).map(|frame| frame.stamp_ns);
    let first = frames.first().map(|frame| frame.stamp_ns);
    let last = frames.last().map(|frame| frame.stamp_ns);
    let stamps: Vec<i64> = first.into_iter().chain(with_features).chain(last).collect();
    let gaps = stamps.windows(2).map(|pair| pair[0]..pair[1]);
    gaps.filter(|gap| gap.end - gap.start > longer_than_ns).collect()
}

/// Draws a comparison: the plan on the left, a panel of errors for each run on the right.
///
/// # Errors
/// The plot cannot be written.
pub fn draw(comparison: &Comparison, path: &Path) -> anyhow::Result<PathBuf> {
    let exaggeration = comparison.exaggeration();
    let mut legend = vec![entry(Mark::Dot, MAP, "keyframes of the map"), entry(Mark::Line, TRUTH, "truth")];
    for (run, colour) in comparison.coloured() {
        legend.push(entry(Mark::Line, colour, &run.name));
    }
    legend.push(entry(Mark::Patch, SHADE, "no matches"));
    let mut caption = comparison.caption.clone();
    caption.push(format!(
        "Left: plan view, errors drawn {exaggeration:.0} times as large. Right: distance from the truth (line), and what \
         the filter claims ({BOUND:.0} sigma, filled)."
    ));
    let height = 552 + canvas::header_height(WIDTH, &caption, &legend) as u32;
    canvas::draw_with_caption(path, (WIDTH, height), &comparison.title, &caption, &legend, |body| {
        let (left, right) = body.split_horizontally(640);
        comparison.draw_plan(&left, exaggeration)?;
        comparison.draw_errors(&right)
    })
}

impl Comparison {
    fn coloured(&self) -> impl Iterator<Item = (&ComparedRun, RGBColor)> {
        self.runs.iter().enumerate().map(|(index, run)| (run, RUN_COLOURS[index.min(RUN_COLOURS.len() - 1)]))
    }

    /// The factor by which errors are drawn longer, so that they can be seen beside the size of the trajectory.
    fn exaggeration(&self) -> f64 {
        let side = |axis: usize| {
            let along = self.truth.rows.iter().map(|row| row.pose.translation[axis]);
            let (low, high) =
                along.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), at| (low.min(at), high.max(at)));
            (high - low).max(0.0)
        };
        let mut sides = [side(0), side(1), side(2)];
        sides.sort_unstable_by(f64::total_cmp);
        let errors = self.runs.iter().flat_map(|run| &run.errors).map(position_error);
        let largest = quantile(errors, SHOWN).unwrap_or(1.0).max(1e-9);
        let fitting = |factor: &&f64| **factor * largest <= EXAGGERATED_SHARE * sides[1];
        EXAGGERATIONS.iter().rev().find(fitting).copied().unwrap_or(1.0)
    }

    fn draw_plan(&self, area: &Area<'_>, exaggeration: f64) -> anyhow::Result<()> {
        let view = PlanView::along(&self.truth.gravity);
        let track = TruthTrack::new(&self.truth.rows);
        let rows = || self.truth.rows.iter();
        let path_line = |positions: Vec<Vector3<f64>>, colour: RGBColor, width: u32| {
            let points: Vec<_> = positions.iter().map(|position| view.project(position)).collect();
            Series::line(thin_path(&points), colour, width)
        };
        let mut series: Vec<Series> = self
            .dropouts
            .iter()
            .map(|stretch| {
                let inside = rows().filter(|row| stretch.contains(&row.stamp_ns));
                path_line(inside.map(|row| row.pose.translation).collect(), SHADE, 22)
            })
            .collect();
        series.push(path_line(rows().map(|row| row.pose.translation).collect(), TRUTH, 3));
        for (run, colour) in self.coloured() {
            let exaggerated = run.poses.iter().filter_map(|pose| {
                let truth = track.pose(pose.stamp_ns, MAX_TRUTH_GAP_NS)?.translation;
                Some(truth + (pose.pose.translation - truth) * exaggeration)
            });
            series.push(path_line(exaggerated.collect(), colour, 2));
        }
        let keyframes = self.keyframes.iter().map(|position| view.project(position)).collect();
        series.push(Series::dots(keyframes, MAP, 2));
        plan(area, series)
    }

    fn draw_errors(&self, area: &Area<'_>) -> anyhow::Result<()> {
        let runs = self.runs.len();
        let errors = || self.runs.iter().flat_map(|run| &run.errors);
        let highest = errors().map(position_error).fold(1e-6, f64::max);
        let widest = quantile(errors().map(claimed_bound), SHOWN).unwrap_or(0.0);
        // The same scale for all, so that they can be compared.
        let top = 1.05 * highest.max(widest);
        for (index, ((run, colour), area)) in
            self.coloured().zip(area.split_evenly((runs.max(1), 1))).enumerate()
        {
            self.error_panel(run, colour, top, index + 1 == runs).draw(&area)?;
        }
        Ok(())
    }

    /// Distance from the truth over time, above the claimed uncertainty.
    fn error_panel(&self, run: &ComparedRun, colour: RGBColor, top: f64, is_last: bool) -> Panel {
        let start_ns = self.truth.rows.first().map_or(0, |row| row.stamp_ns);
        let end_ns = self.truth.rows.last().map_or(1, |row| row.stamp_ns);
        let seconds = |stamp_ns: i64| (stamp_ns - start_ns) as f64 * 1e-9;
        let points = |value: &dyn Fn(&ErrorSample) -> f64| -> Vec<(f64, f64)> {
            run.errors.iter().map(|sample| (seconds(sample.stamp_ns), value(sample))).collect()
        };
        let dropouts: Vec<Range<f64>> =
            self.dropouts.iter().map(|stretch| seconds(stretch.start)..seconds(stretch.end)).collect();
        let shades = Series::columns(&dropouts, SHADE);
        let claimed =
            Series { points: thin(&points(&claimed_bound)), colour: pale(colour), shape: Shape::Band };
        let error = Series::line(thin(&points(&position_error)), colour, 2);
        Panel {
            title: format!("{}. {}", run.name, run.figures),
            x_label: if is_last { "time [s]" } else { "" },
            y_label: "error [m]".to_owned(),
            x: 0.0..seconds(end_ns).max(1e-3),
            y: 0.0..top,
            series: shades.chain([claimed, error]).collect(),
        }
    }
}

/// Distance from the truth, metres.
fn position_error(sample: &ErrorSample) -> f64 {
    sample.error.fixed_rows::<3>(3).norm()
}

/// What the filter claims of this distance: three standard deviations of the position, all axes together, metres.
fn claimed_bound(sample: &ErrorSample) -> f64 {
    BOUND * sample.sigma.fixed_rows::<3>(3).norm()
}

/// A lighter tint of a colour.
fn pale(colour: RGBColor) -> RGBColor {
    let lighter = |part: u8| (f64::from(part) * 0.35 + 255.0 * 0.65) as u8;
    RGBColor(lighter(colour.0), lighter(colour.1), lighter(colour.2))
}
