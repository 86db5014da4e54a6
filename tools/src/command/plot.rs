//! `driftless plot`: the plots of a run.

use crate::plotting::{RunFiles, draw_png, draw_run, read_keyframes};
use anyhow::{Context, ensure};
use nalgebra::Vector3;
use serde_json::json;
use std::path::PathBuf;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  driftless plot out\n  driftless plot out --png\n  \
    driftless plot out --groundtruth REC/mav0/state_groundtruth_estimate0/data.csv --keyframes map/keyframes.csv\n\n\
    Draws trajectory.svg, over_time.svg, error_local.svg, error_transform.svg, error_pose.svg and reprojection.svg.\n\
    Plots for which the run has no data are left out, and named with the reason.")]
pub struct Args {
    /// Output folder of a run, with its states.csv
    #[arg(value_name = "DIR")]
    run: PathBuf,
    /// Ground truth [default: that of the recording which summary.json names]
    #[arg(long, value_name = "FILE")]
    groundtruth: Option<PathBuf>,
    /// Direction of gravity in the ground truth's frame [default: computed from the recording]
    #[arg(long, value_name = "X,Y,Z", value_delimiter = ',', allow_hyphen_values = true)]
    gravity: Option<Vec<f64>>,
    /// keyframes.csv of the map in plain text, to draw them in the plan view
    #[arg(long, value_name = "FILE")]
    keyframes: Option<PathBuf>,
    /// Folder for the plots [default: DIR]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Write each plot as PNG, too
    #[arg(long)]
    png: bool,
    /// Pixels of a PNG, times those of the SVG
    #[arg(long, value_name = "FACTOR", default_value_t = 2.0, requires = "png")]
    scale: f32,
    /// Print the list of plots as JSON
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// A run without `states.csv`, a file that cannot be parsed, a plot that cannot be written.
pub fn run(args: &Args) -> anyhow::Result<()> {
    ensure!((0.1..=8.0).contains(&args.scale), "--scale {}: give a factor from 0.1 to 8", args.scale);
    let gravity = args.gravity.as_deref().map(direction).transpose()?;
    let mut run =
        RunFiles::read(&args.run, args.groundtruth.as_deref(), gravity).context("the run cannot be drawn")?;
    if let Some(path) = &args.keyframes {
        run.keyframes = read_keyframes(path).context("the keyframes cannot be drawn")?;
    }
    let mut drawn = draw_run(&run, args.out.as_deref().unwrap_or(&args.run))?;
    if args.png {
        let pixels: Result<Vec<_>, _> = drawn.pictures.iter().map(|svg| draw_png(svg, args.scale)).collect();
        drawn.pictures.extend(pixels?);
    }
    if args.json {
        println!(
            "{}",
            serde_json::to_string_pretty(&json!({"pictures": drawn.pictures, "missing": drawn.missing}))?
        );
        return Ok(());
    }
    for picture in &drawn.pictures {
        println!("{}", picture.display());
    }
    for sentence in &drawn.missing {
        eprintln!("{sentence}");
    }
    Ok(())
}

fn direction(given: &[f64]) -> anyhow::Result<Vector3<f64>> {
    ensure!(given.len() == 3, "--gravity takes three numbers, as in 0,0,-1");
    Vector3::from_column_slice(given)
        .try_normalize(1e-9)
        .filter(|unit| unit.iter().all(|value| value.is_finite()))
        .context("--gravity must be a direction, as in 0,0,-1")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gravity_has_a_direction() {
        assert_eq!(direction(&[0.0, 0.0, -9.81]).unwrap(), -Vector3::z());
        for wrong in [&[0.0; 3][..], &[0.0, f64::NAN, -1.0], &[f64::INFINITY, 0.0, 0.0], &[0.0, 1.0]] {
            assert!(direction(wrong).is_err(), "{wrong:?}");
        }
    }
}
