//! `driftless simulate`: a simulated place and two runs through it, as recordings on disk: with tracks and features, or with
//! images.

use anyhow::{Context, bail};
use evaluation::trajectory::{StampedPose, tum};
use indicatif::{ProgressBar, ProgressStyle};
use sensors::{Sequence, writer};
use serde::Serialize;
use simulation::images::{ImageOptions, simulate_images, write_images};
use simulation::{SimulationOptions, simulate};
use std::path::{Path, PathBuf};

/// Names of the two recordings.
const RECORDINGS: [&str; 2] = ["map", "live"];

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  driftless simulate --out town --seed 3\n  \
    driftless simulate --out hall --trajectory MH_01.tum --live-trajectory MH_03.tum\n  \
    driftless simulate --out room --images --duration 20\n\n\
    Writes two recordings in the EuRoC layout: OUT/map, with reference poses, and OUT/live. Then:\n  \
    driftless build-map OUT/map --map town.db --sigma-pixel 1 --gravity 0,0,-1\n  \
    driftless run OUT/live --map town.db --init truth --out run\n  \
    driftless plot run\n\n\
    With --images two flights through one room are rendered, stereo at 20 Hz, instead of tracks and features along a street.\n\
    Leave --sigma-pixel out then: what the features of images are worth is measured.")]
pub struct Args {
    /// Folder to write; the recordings `map` and `live` are created in it
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Seed; the same seed gives the same files
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Render images of a furnished room, as PNG files; about 0.3 MB each, 40 a second of the runs
    #[arg(long, conflicts_with_all = ["trajectory", "live_trajectory", "speed", "pixel_noise", "outliers", "dropout"])]
    images: bool,
    /// Length of the live run, seconds; the map's run is 5 s longer [default: to the end of the trajectory; with --images 30]
    #[arg(long, value_name = "SECONDS")]
    duration: Option<f64>,
    /// Trajectory of the map's run, a TUM file of the body (x forward, z up) [default: once round a block of houses]
    #[arg(long, value_name = "TUM")]
    trajectory: Option<PathBuf>,
    /// Trajectory of the live run, a TUM file [default: that of the map's run, 1 m to the left]
    #[arg(long, value_name = "TUM")]
    live_trajectory: Option<PathBuf>,
    /// Cruising speed on the built-in trajectory, m/s
    #[arg(long, default_value_t = SimulationOptions::default().speed)]
    speed: f64,
    /// Standard deviation of tracked pixels, px
    #[arg(long, value_name = "PX", default_value_t = SimulationOptions::default().sigma_track_px)]
    pixel_noise: f64,
    /// Fraction of tracked pixels that are 10 to 50 px off
    #[arg(long, value_name = "FRACTION", default_value_t = 0.0)]
    outliers: f64,
    /// Fraction of the live run without features to match
    #[arg(long, value_name = "FRACTION", default_value_t = SimulationOptions::default().dropout_fraction)]
    dropout: f64,
    /// Standard deviation of the map's reference positions, metres an axis
    #[arg(long, value_name = "M", default_value_t = SimulationOptions::default().sigma_reference_p_m)]
    sigma_reference_p_m: f64,
    /// Standard deviation of the map's reference rotations, rad an axis
    #[arg(long, value_name = "RAD", default_value_t = SimulationOptions::default().sigma_reference_theta_rad)]
    sigma_reference_theta_rad: f64,
    /// Replace the files of recordings that are there already
    #[arg(long)]
    force: bool,
    /// Print what was written as JSON
    #[arg(long)]
    json: bool,
}

/// Contents of one recording.
#[derive(Serialize)]
struct Summary {
    path: PathBuf,
    duration_s: f64,
    distance_m: f64,
    frames: usize,
    imu_samples: usize,
    track_observations: usize,
    images_with_features: usize,
    images: usize,
}

/// Runs the command.
///
/// # Errors
/// Options out of range, a trajectory that cannot be read, recordings that are there already, a folder that cannot be
/// written.
pub fn run(args: &Args) -> anyhow::Result<()> {
    refuse_to_replace(args)?;
    let options = options(args)?;
    let scenario =
        if args.images { simulate_images(&options, &ImageOptions::default()) } else { simulate(&options) };
    let scenario = scenario.context("the simulation is impossible")?;
    let mut summaries = Vec::new();
    for (name, sequence) in RECORDINGS.into_iter().zip([&scenario.map, &scenario.live]) {
        let root = args.out.join(name);
        writer::write(sequence, &root).context("the recording was not written")?;
        if args.images {
            let bar = image_bar(name, args.json);
            write_images(sequence, &root, |done, all| {
                bar.set_length(all as u64);
                bar.set_position(done as u64);
            })?;
            bar.finish_and_clear();
        }
        summaries.push(summary(root, sequence));
    }
    if args.json {
        println!("{}", serde_json::to_string_pretty(&summaries)?);
        return Ok(());
    }
    for summary in &summaries {
        let of_frames = if args.images {
            format!("{} images", summary.images)
        } else {
            format!(
                "{} tracked pixels, {} images with features",
                summary.track_observations, summary.images_with_features
            )
        };
        println!(
            "{}: {:.0} m in {:.0} s, {} frames, {of_frames}, {} IMU samples",
            summary.path.display(),
            summary.distance_m,
            summary.duration_s,
            summary.frames,
            summary.imu_samples
        );
    }
    Ok(())
}

/// Refuses a folder with recordings, which nothing tells from recorded ones.
fn refuse_to_replace(args: &Args) -> anyhow::Result<()> {
    let roots = RECORDINGS.map(|name| args.out.join(name));
    if let Some(root) = roots.iter().find(|root| !args.force && root.join("mav0").exists()) {
        bail!(
            "{} is a recording already: name another --out, or use --force to replace its files",
            root.display()
        );
    }
    Ok(())
}

fn options(args: &Args) -> anyhow::Result<SimulationOptions> {
    let usual = if args.images { ImageOptions::simulation() } else { SimulationOptions::default() };
    Ok(SimulationOptions {
        seed: args.seed,
        speed: args.speed,
        duration_s: args.duration.or(usual.duration_s),
        map_trajectory: args.trajectory.as_deref().map(read_trajectory).transpose()?,
        live_trajectory: args.live_trajectory.as_deref().map(read_trajectory).transpose()?,
        sigma_track_px: args.pixel_noise,
        outlier_fraction: args.outliers,
        dropout_fraction: args.dropout,
        sigma_reference_p_m: args.sigma_reference_p_m,
        sigma_reference_theta_rad: args.sigma_reference_theta_rad,
        ..usual
    })
}

/// A bar over the images of a run, or none that is seen.
fn image_bar(run: &str, hidden: bool) -> ProgressBar {
    let bar = if hidden { ProgressBar::hidden() } else { ProgressBar::new(0) };
    if let Ok(style) = ProgressStyle::with_template("{msg} [{wide_bar}] {pos}/{len} {elapsed_precise}") {
        bar.set_style(style.progress_chars("=> "));
    }
    bar.set_message(format!("images of {run}"));
    bar
}

fn read_trajectory(path: &Path) -> anyhow::Result<Vec<StampedPose>> {
    tum::read(path).context("the trajectory cannot be read")
}

fn summary(path: PathBuf, sequence: &Sequence) -> Summary {
    let truth = sequence.groundtruth.as_deref().unwrap_or_default();
    let step = |pair: &[sensors::TruthRow]| (pair[1].pose.translation - pair[0].pose.translation).norm();
    let span = truth.first().zip(truth.last()).map_or(0, |(first, last)| last.stamp_ns - first.stamp_ns);
    Summary {
        path,
        duration_s: span as f64 * 1e-9,
        distance_m: truth.windows(2).map(step).sum(),
        frames: sequence.frames.len(),
        imu_samples: sequence.imu_samples.len(),
        track_observations: sequence.frames.iter().map(|frame| frame.tracks.len()).sum(),
        images_with_features: sequence.frames.iter().filter(|frame| !frame.features.is_empty()).count(),
        images: sequence.frames.iter().map(|frame| frame.images.len()).sum(),
    }
}
