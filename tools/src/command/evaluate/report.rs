//! What `evaluate` prints.

use evaluation::{Nees, Statistics};
use serde::Serialize;

use super::{AlignArgument, Args, UnitArgument};

/// The figures.
#[derive(Debug, Serialize)]
pub(super) struct Report {
    pub(super) pairs: usize,
    /// What was compared, in words.
    pub(super) scored: String,
    /// Factor on the estimate's positions, with `--align sim3`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) scale: Option<f64>,
    pub(super) ate_m: Option<Statistics>,
    pub(super) ate_deg: Option<Statistics>,
    pub(super) rpe_m: Option<Statistics>,
    pub(super) rpe_deg: Option<Statistics>,
    pub(super) nees: Option<NeesReport>,
    /// Why there is no NEES, although the estimate has covariances.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) no_nees: Option<&'static str>,
    /// Poses that are not in the NEES, because their covariance is not positive definite.
    pub(super) nees_left_out: usize,
}

/// Consistency, with the bounds of one sample: the errors of one trajectory are correlated in time.
#[derive(Debug, Serialize)]
pub(super) struct NeesReport {
    #[serde(flatten)]
    pub(super) mean: Nees,
    pub(super) samples: usize,
    pub(super) bounds_3: Option<(f64, f64)>,
    pub(super) bounds_6: Option<(f64, f64)>,
}

/// Prints the figures.
pub(super) fn print(report: &Report, args: &Args) {
    let align = match args.align {
        AlignArgument::None => "not aligned",
        AlignArgument::Yaw => "aligned in yaw and position",
        AlignArgument::Se3 => "aligned in rotation and position",
        AlignArgument::Sim3 => "aligned in rotation, position and scale",
    };
    println!("{} pairs of poses ({}), {align}", report.pairs, report.scored);
    if let Some(scale) = report.scale {
        println!("scale           {scale:>12.6}");
    }
    println!("{:<16}{:>12}{:>12}{:>12}{:>12}{:>12}", "", "rmse", "mean", "median", "std", "max");
    let unit = match args.delta_unit {
        UnitArgument::Frames => "frames",
        UnitArgument::Metres => "m",
        UnitArgument::Seconds => "s",
    };
    for (name, statistics) in [
        ("ATE [m]", &report.ate_m),
        ("ATE [deg]", &report.ate_deg),
        ("RPE [m]", &report.rpe_m),
        ("RPE [deg]", &report.rpe_deg),
    ] {
        match statistics {
            Some(s) => println!(
                "{name:<16}{:>12.6}{:>12.6}{:>12.6}{:>12.6}{:>12.6}",
                s.rmse, s.mean, s.median, s.std, s.max
            ),
            None => println!("{name:<16}   no segment of {} {unit} is complete", args.delta),
        }
    }
    if let Some(nees) = &report.nees {
        let bounds = |bounds: Option<(f64, f64)>| {
            bounds.map_or_else(String::new, |(low, high)| format!(" ({low:.3} to {high:.3})"))
        };
        println!(
            "NEES per degree of freedom over {} poses, 1 is consistent (95 % bounds of one sample: errors of one run are correlated): \
             rotation {:.3}{}, position {:.3}{}, pose {:.3}{}",
            nees.samples,
            nees.mean.rotation,
            bounds(nees.bounds_3),
            nees.mean.position,
            bounds(nees.bounds_3),
            nees.mean.pose,
            bounds(nees.bounds_6)
        );
    }
    if let Some(reason) = report.no_nees {
        println!("no NEES: {reason}");
    }
    if report.nees_left_out > 0 {
        println!(
            "NEES without {} of {} poses, whose covariance is not positive definite",
            report.nees_left_out, report.pairs
        );
    }
}
