//! The robot: plays a recording through the estimator and localizes it in a served map.

use anyhow::{Context as _, Result, bail};
use clap::Parser;
use client::session::{DEFAULT_ENDPOINT, SessionOptions, close_session, open_session};
use estimator::MapMode;
use onboard::{MapLink, RobotArguments, StopSignal, progress, run_robot_until, stdout};
use sensors::Recording;
use std::io::IsTerminal as _;
use std::path::PathBuf;
use std::process::ExitCode;
use tracing_subscriber::EnvFilter;

/// Warnings, but not Zenoh's about a network that is still being found.
const QUIET: &str = "warn,zenoh=error";

/// Plays a recording and localizes it in a map that a map server serves.
///
/// The estimator never waits for the network: without a server, or with a dead one, the robot keeps
/// its odometry and says so in its status.
#[derive(Parser, Debug)]
#[command(
    version,
    arg_required_else_help = true,
    after_help = "Examples:\n  \
        onboard --sequence MH_03 --map hall --connect tcp/192.168.1.2:7447 --init truth --out run\n  \
        onboard --sequence MH_03 --mode odometry --out run"
)]
struct Arguments {
    /// The recording, a folder in the EuRoC layout
    #[arg(long, value_name = "SEQ")]
    sequence: PathBuf,
    /// Name of the map on the server (not needed with --mode odometry)
    #[arg(long, value_name = "NAME")]
    map: Option<String>,
    /// Where the map server is [default: tcp/127.0.0.1:7447]
    #[arg(long, value_name = "ENDPOINT")]
    connect: Vec<String>,
    /// Zenoh configuration file (JSON5)
    #[arg(long, value_name = "FILE")]
    zenoh_config: Option<PathBuf>,
    /// Namespace of the fleet
    #[arg(long)]
    namespace: Option<String>,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    robot: RobotArguments,
}

fn main() -> ExitCode {
    stdout::end_quietly_when_closed();
    match localize() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn localize() -> Result<()> {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(QUIET));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .init();
    let arguments = Arguments::parse();
    let stop = StopSignal::on_interrupt()?;
    let recording = Recording::open(&arguments.sequence)?;
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
    let link = match (&arguments.map, arguments.robot.map_mode()?) {
        (_, MapMode::Odometry) => None,
        (None, _) => bail!("--map NAME is missing: name the map, or use --mode odometry"),
        (Some(map), _) => {
            let mut connect = arguments.connect.clone();
            if connect.is_empty() && arguments.zenoh_config.is_none() {
                connect.push(DEFAULT_ENDPOINT.to_owned());
            }
            let options = SessionOptions {
                config_file: arguments.zenoh_config.clone(),
                connect,
                namespace: arguments.namespace.clone(),
                ..SessionOptions::default()
            };
            let session = runtime.block_on(open_session(&options)).context("no network")?;
            Some(MapLink { session, runtime: runtime.handle().clone(), map: map.clone() })
        }
    };
    let session = link.as_ref().map(|link| link.session.clone());
    let bar = progress::frame_bar(recording.contents().frames);
    let show = |frame| bar.set_position(frame as u64);
    let outcome = run_robot_until(&stop, recording, &arguments.robot, link, show)?;
    bar.finish_and_clear();
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&outcome.summary)?);
    } else {
        print!("{}", progress::report(&outcome));
        println!("written to {}", arguments.robot.out.display());
    }
    if let Some(session) = session {
        runtime.block_on(close_session(&session));
    }
    if let Some(reason) = &outcome.summary.ended_early {
        bail!("the run ended early: {reason}");
    }
    Ok(())
}
