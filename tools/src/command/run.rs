//! `driftless run`: server and robot in one process.

use super::view;
use crate::in_process::{LocalServer, load_map};
use anyhow::{Result, bail};
use estimator::MapMode;
use onboard::arguments::{CalibrationArguments, INPUT};
use onboard::{RobotArguments, RobotLink, StopSignal, progress, run_robot_until};
use sensors::Recording;
use std::path::PathBuf;

/// Arguments of `driftless run`.
#[derive(clap::Args, Debug)]
#[command(
    after_help = "Examples:\n  driftless run --sequence place/live --map place.db --init truth --out run\n  \
    driftless run --sequence place/live --mode odometry --out run\n\nThen: driftless plot run\n\n\
    Exit code: 0, or 3 for a run that ended lost, 1 for an error, 2 for wrong switches"
)]
pub struct Args {
    /// The recording: a folder in the EuRoC layout, or a bag (MCAP, rosbag2, rosbag1)
    #[arg(long, value_name = "DIR|FILE", help_heading = INPUT)]
    sequence: PathBuf,
    /// Calibration
    #[command(flatten)]
    calibration: CalibrationArguments,
    /// The map's database (not needed with --mode odometry)
    #[arg(long, value_name = "DB")]
    map: Option<PathBuf>,
    /// Print the summary as JSON
    #[arg(long, conflicts_with = "open")]
    json: bool,
    /// At its end, show the run in the system's browser until Ctrl-C, as `driftless view` does
    #[arg(long)]
    open: bool,
    #[command(flatten)]
    robot: RobotArguments,
}

/// Runs the robot beside a server of its own.
///
/// # Errors
/// What the recording, the map or the output folder lacks; a run that ended early.
pub fn run(args: &Args) -> Result<()> {
    let stop = StopSignal::on_interrupt()?;
    let recording = Recording::open_with(&args.sequence, &args.calibration.files())?;
    let server = match (&args.map, args.robot.map_mode()?) {
        (_, MapMode::Odometry) => None,
        (None, _) => {
            bail!("--map DB is missing: build one with `driftless build-map`, or use --mode odometry")
        }
        (Some(database), _) => Some(LocalServer::start(vec![("map".to_owned(), load_map(database)?)])?),
    };
    let link = server.as_ref().map(|server| server.link("map")).transpose()?;
    let bar = progress::frame_bar(recording.contents().frames);
    let show = |frame| bar.set_position(frame as u64);
    let outcome = run_robot_until(&stop, recording, &args.robot, link.clone().map(RobotLink::Open), show)?;
    bar.finish_and_clear();
    if let Some(server) = server {
        if let Some(link) = &link {
            server.unlink(link);
        }
        server.stop()?;
    }
    if args.json {
        println!("{}", serde_json::to_string_pretty(&outcome.summary)?);
    } else {
        print!("{}", progress::report(&outcome.summary));
        println!("written to {}", args.robot.out.display());
    }
    if args.open && !stop.is_stopped() {
        view::run(&view::Args::of_run(args.robot.out.clone(), args.map.clone()))?;
    }
    if let Some(reason) = &outcome.summary.ended_early {
        bail!("the run ended early: {reason}");
    }
    outcome.summary.check_end()?;
    Ok(())
}
