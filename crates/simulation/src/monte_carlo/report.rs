//! The scores as a table.

use super::{CalibrationError, EnsembleScore, OutputScore, VariantRuns};
use evaluation::trajectory::StateKind;
use evaluation::{EnsembleNees, Verdict, nees_bounds};
use std::fmt::Write as _;

/// Name of an output in tables and plots.
pub fn name_of(kind: StateKind) -> &'static str {
    match kind {
        StateKind::LocalFromImu => "local pose",
        StateKind::GlobalFromLocal => "G_T_L",
        StateKind::GlobalFromImu => "pose in G",
    }
}

/// All scores as text, a block of lines a variant.
///
/// # Arguments
/// * `scores`: of `all`, in the same order.
pub fn table(title: &str, all: &[VariantRuns], scores: &[EnsembleScore]) -> String {
    let mut text = format!("{title}\n");
    for (runs, score) in all.iter().zip(scores) {
        // Writing into a string cannot fail.
        let _ = writeln!(
            text,
            "\n{:<22} {:>8} {:>8}   {:<32}{:<32}NEES pose",
            score.name, "RMSE deg", "m", "NEES rotation", "NEES position"
        );
        for kind in StateKind::ALL {
            if let Some(output) = score.get(kind) {
                let _ = writeln!(text, "  {:<20} {}", name_of(kind), line(output, kind));
            }
        }
        for remark in remarks(runs, score) {
            let _ = writeln!(text, "  {remark}");
        }
    }
    let runs = scores.first().map_or(0, |score| score.runs);
    if let (Some(three), Some(six)) = (bounds(3, runs), bounds(6, runs)) {
        let _ = writeln!(
            text,
            "\n95 % of {runs} runs: rotation and position {:.2}..{:.2}, pose {:.2}..{:.2}; see --help",
            three.0, three.1, six.0, six.1
        );
    }
    text
}

fn bounds(degrees_of_freedom: usize, runs: usize) -> Option<(f64, f64)> {
    nees_bounds(degrees_of_freedom, runs, super::score::CONFIDENCE)
}

fn line(output: &OutputScore, kind: StateKind) -> String {
    let cell = |nees: &EnsembleNees| {
        let spread =
            nees.mean_interval.map_or_else(String::new, |(low, high)| format!("[{low:.2} {high:.2}]"));
        // One sample a run: no fraction of times.
        let times = match kind {
            StateKind::GlobalFromLocal => String::new(),
            _ => format!("{:.0} %", 100.0 * nees.times_inside),
        };
        format!("{:>6.2} {:<5}{spread:<13} {times:<6}", nees.mean, mark(nees.verdict))
    };
    format!(
        "{:>8.3} {:>8.3}   {}{}{}",
        output.rmse_deg,
        output.rmse_m,
        cell(&output.rotation),
        cell(&output.position),
        cell(&output.pose)
    )
}

fn mark(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Inside => "ok",
        Verdict::Near => "near",
        Verdict::Overconfident => "HIGH",
        Verdict::Conservative => "LOW",
    }
}

fn remarks(runs: &VariantRuns, score: &EnsembleScore) -> Vec<String> {
    let mut remarks = Vec::new();
    if let Some((trial, reason)) =
        runs.trials.iter().find_map(|trial| Some((trial, trial.diverged.as_ref()?)))
    {
        remarks.push(format!("{} runs ended early; seed {}: {reason}", score.diverged, trial.seed));
    }
    for kind in StateKind::ALL {
        if let Some(output) = score.get(kind).filter(|output| output.pose.runs < score.runs) {
            let (some, all) = (output.pose.runs, score.runs);
            remarks.push(format!("{}: of {some} of {all} runs, the others have none", name_of(kind)));
        }
    }
    if score.not_localized > 0 {
        remarks.push(format!("{} runs were not localized at the end", score.not_localized));
    }
    let map = &score.map;
    if map.answers + map.wrong_places > 0 {
        let mut counts = format!("{} of {} replies used", map.used, map.answers);
        if map.wrong_places > 0 {
            let _ = write!(counts, ", {} of {} of wrong places", map.wrong_places_used, map.wrong_places);
        }
        remarks.push(format!("{counts}; {} moved the pose in G by more than 3 sigma", map.jumps));
        remarks.push(format!(
            "{} of {} runs ended within 3 sigma of the true pose in G",
            score.ended_within_3_sigma, score.runs
        ));
    }
    remarks.extend(calibration_remark(runs));
    remarks
}

/// Errors of the stated calibration, where it has any, and of the estimated one.
fn calibration_remark(runs: &VariantRuns) -> Option<String> {
    let stated = runs.trials.first()?.stated_calibration.first()?;
    let is_wrong =
        stated.deg > 1e-9 || stated.m > 0.0 || stated.seconds != 0.0 || stated.focal_fraction > 0.0;
    let completed = runs.trials.iter().filter(|trial| trial.diverged.is_none());
    let estimated: Vec<&CalibrationError> =
        completed.filter_map(|trial| trial.estimated_calibration.first()).collect();
    let mean = |of: &dyn Fn(&CalibrationError) -> f64| {
        estimated.iter().map(|error| of(error).abs()).sum::<f64>() / estimated.len().max(1) as f64
    };
    let ended = CalibrationError {
        deg: mean(&|error| error.deg),
        m: mean(&|error| error.m),
        seconds: mean(&|error| error.seconds),
        focal_fraction: mean(&|error| error.focal_fraction),
    };
    is_wrong.then(|| {
        format!(
            "stated calibration off by {}, estimated at the end off by {} in the mean",
            describe(stated),
            describe(&ended)
        )
    })
}

fn describe(error: &CalibrationError) -> String {
    let CalibrationError { deg, m, seconds, focal_fraction } = error;
    format!(
        "{deg:.2} deg, {m:.3} m, {:.1} ms, {:.2} % of focal length",
        1e3 * seconds.abs(),
        100.0 * focal_fraction
    )
}
