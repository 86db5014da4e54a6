//! The robot program: plays a recording through the estimator, and localizes it in the map of a map server.

use anyhow::{Context as _, Result, bail};
use clap::Parser;
use client::session::{Member, Role};
use client::{SessionArguments, without_secrets};
use estimator::MapMode;
use monitoring::{LogFormat, MonitoringServer, start_log};
use onboard::arguments::{CalibrationArguments, DEFAULT_ROBOT, INPUT, MAP, OUTPUT};
use onboard::{
    EndedLost, OpeningLink, RobotArguments, RobotLink, RobotMetrics, StopSignal, progress, run_robot_until,
    stdout,
};
use prometheus_client::registry::Registry;
use sensors::Recording;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::ExitCode;
use tracing_subscriber::EnvFilter;

/// Log filter: warnings, without Zenoh's about a network that is still being discovered, but with why it does not connect.
const QUIET: &str = "warn,client::session=info,zenoh=error,zenoh::net::runtime::orchestrator=warn";
/// Log filter in real time: changes of the state and a line a minute as well.
const REALTIME: &str =
    "warn,onboard=info,client::session=info,zenoh=error,zenoh::net::runtime::orchestrator=warn";

/// Plays a recording and localizes it in the map of a map server.
///
/// The estimator never waits for the network: without a server the robot continues with odometry, and its status says so.
#[derive(Parser, Debug)]
#[command(
    version,
    arg_required_else_help = true,
    after_help = "Examples:\n  \
        onboard --sequence MH_03 --map hall --connect tcp/192.168.1.2:7447 --out run\n  \
        onboard --sequence MH_03 --mode odometry --out run\n  \
        onboard --sequence MH_03 --map hall --realtime --robot cart7 --namespace site1 --out run\n\n\
        Log: RUST_LOG=info; with --realtime, changes of the state and a line a minute are logged anyway. Ctrl-C ends the run in good order; the output folder is complete up to there.\n\
        Then: driftless plot run"
)]
struct Arguments {
    /// The recording: a folder in the EuRoC layout, or a bag (MCAP, rosbag2, rosbag1)
    #[arg(long, value_name = "DIR|FILE", help_heading = INPUT)]
    sequence: PathBuf,
    /// Calibration
    #[command(flatten)]
    calibration: CalibrationArguments,
    /// Name of the map on the server (not needed with --mode odometry)
    #[arg(long, value_name = "NAME", help_heading = MAP)]
    map: Option<String>,
    /// How the robot is connected [default: --connect tcp/127.0.0.1:7447]
    #[command(flatten)]
    session: SessionArguments,
    /// Address of an HTTP server of metrics (/metrics, for Prometheus) and health (/health), for example 127.0.0.1:9465
    ///
    /// It knows no users: use an address that only operators reach.
    #[arg(long, value_name = "ADDRESS:PORT", help_heading = OUTPUT)]
    monitoring: Option<SocketAddr>,
    /// Format of the log: text for people, json for programs, one object a line
    #[arg(long, value_name = "FORMAT", default_value_t, help_heading = OUTPUT)]
    log_format: LogFormat,
    /// Print the summary as JSON
    #[arg(long, help_heading = OUTPUT)]
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
            if error.is::<EndedLost>() { ExitCode::from(EndedLost::EXIT_CODE) } else { ExitCode::FAILURE }
        }
    }
}

fn localize() -> Result<()> {
    let mut arguments = Arguments::parse();
    let quiet = if arguments.robot.realtime { REALTIME } else { QUIET };
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(quiet));
    start_log(without_secrets(filter), arguments.log_format);
    if let Some(folder) = &arguments.session.secure {
        // Not given is what the default says.
        let given = Some(arguments.robot.robot.as_str()).filter(|name| *name != DEFAULT_ROBOT);
        arguments.robot.robot = Member::expect(folder, Role::Robot, ("--robot", given))?;
    }
    let stop = StopSignal::on_interrupt().context("signals cannot be handled")?;
    let recording = Recording::open_with(&arguments.sequence, &arguments.calibration.files())?;
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
    let monitoring = match arguments.monitoring {
        Some(address) => Some(runtime.block_on(start_monitoring(address, &arguments.robot.metrics))?),
        None => None,
    };
    let link = match (&arguments.map, arguments.robot.map_mode()?) {
        (_, MapMode::Odometry) => None,
        (None, _) => {
            bail!("--map NAME is missing: give the name of the map on the server, or use --mode odometry")
        }
        (Some(map), _) => {
            let options = arguments.session.connecting();
            let link = OpeningLink::open(options, runtime.handle().clone(), map)
                .context("the Zenoh session cannot be opened")?;
            Some(RobotLink::Opening(link))
        }
    };
    let bar = progress::frame_bar(recording.contents().frames);
    let show = |frame| bar.set_position(frame as u64);
    let outcome = run_robot_until(&stop, recording, &arguments.robot, link, show)?;
    bar.finish_and_clear();
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&outcome.summary)?);
    } else {
        print!("{}", progress::report(&outcome.summary));
        println!("written to {}", arguments.robot.out.display());
    }
    if let Some(monitoring) = monitoring {
        runtime.block_on(monitoring.stop());
    }
    if let Some(reason) = &outcome.summary.ended_early {
        bail!("the run ended early: {reason}");
    }
    outcome.summary.check_end()?;
    Ok(())
}

/// Serves the metrics of a run.
async fn start_monitoring(address: SocketAddr, metrics: &RobotMetrics) -> Result<MonitoringServer> {
    let mut registry = Registry::with_prefix("driftless");
    metrics.register(&mut registry);
    let health = metrics.clone();
    MonitoringServer::start(address, registry, move || health.health()).await.context("--monitoring")
}
