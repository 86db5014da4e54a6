//! `driftless run`: server and robot in one process.

use crate::in_process::{LocalServer, MAP, gravity_in_own_frame, load_map};
use crate::open_page::{announce, stay};
use anyhow::{Result, bail};
use estimator::MapMode;
use onboard::arguments::CalibrationArguments;
use onboard::{MapLink, RobotArguments, RobotLink, StopSignal, progress, run_robot_until};
use sensors::Recording;
use std::path::PathBuf;

/// Arguments of `driftless run`.
#[derive(clap::Args, Debug)]
#[command(after_help = "Examples:\n  driftless run place/live --map place.db --init truth --out run\n  \
    driftless run place/live --mode odometry --out run\n  \
    driftless run place/live --map place.db --out run --open --realtime\n\nThen: driftless plot run\n\n\
    Exit code: 0, or 3 for a run that ended lost, 1 for an error, 2 for wrong switches")]
pub struct Args {
    /// The recording: a folder in the EuRoC layout, or a bag (MCAP, rosbag2, rosbag1)
    #[arg(value_name = "REC")]
    recording: PathBuf,
    /// Calibration
    #[command(flatten)]
    calibration: CalibrationArguments,
    /// The map's database, or its releases: a folder or URL, with @7 for release 7, or @candidate (not needed with --mode odometry)
    #[arg(long, value_name = "DB|URL")]
    map: Option<PathBuf>,
    /// Print the summary as JSON
    #[arg(long, conflicts_with = "open")]
    json: bool,
    /// Show map and robot in the system's browser from the start, and the whole run at its end, until Ctrl-C
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
    let files = args.robot.recording_files(&args.calibration)?;
    let recording = Recording::open_with(&args.recording, &files)?;
    let maps = match (&args.map, args.robot.map_mode()?) {
        (Some(database), MapMode::Odometry) => {
            tracing::warn!("--map {} is not used: --mode odometry asks no map", database.display());
            Vec::new()
        }
        (None, MapMode::Odometry) => Vec::new(),
        (None, _) => {
            bail!(
                "--map DB is missing: build one with `driftless build-map REC --map DB`, or use --mode odometry"
            )
        }
        (Some(database), _) => vec![(MAP.to_owned(), load_map(database)?)],
    };
    let mut robot = args.robot.clone();
    robot.mount_as_in(&recording);
    if let Some((_, map)) = maps.first() {
        robot.features = robot.features.or_of_map(&map.info().extractor);
        robot.gravity_in_own_frame = gravity_in_own_frame(map);
    }
    let has_map = !maps.is_empty();
    let mut server = (has_map || args.open).then(|| LocalServer::start(maps)).transpose()?;
    if let Some(server) = server.as_mut().filter(|_| args.open) {
        announce(&server.show()?);
    }
    let link = server.as_ref().map(|server| server.link(MAP)).transpose()?;
    let robot_link = link.clone().map(|link| match link {
        link if has_map => RobotLink::Open(link),
        // It publishes for the page.
        MapLink { session, runtime, .. } => RobotLink::Network { session, runtime },
    });
    let bar = progress::frame_bar(recording.contents().frames);
    let show = |frame| bar.set_position(frame as u64);
    let outcome = run_robot_until(&stop, recording, &robot, robot_link, show)?;
    bar.finish_and_clear();
    if let Some((server, link)) = server.as_ref().zip(link.as_ref()) {
        server.unlink(link);
    }
    if args.json {
        println!("{}", serde_json::to_string_pretty(&outcome.summary)?);
    } else {
        print!("{}", progress::report(&outcome.summary));
        println!("written to {}", args.robot.out.display());
    }
    if let Some(server) = server {
        if args.open && !stop.is_stopped() {
            stay(&server, &args.robot.out, &stop);
        }
        server.stop()?;
    }
    if let Some(reason) = &outcome.summary.ended_early {
        bail!("the run ended early: {reason}");
    }
    outcome.summary.check_end()?;
    Ok(())
}
