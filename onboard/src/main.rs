//! The robot program: plays a recording through the estimator, and localizes it in the map of a map server.

use anyhow::{Context as _, Result, bail};
use clap::Parser;
use client::session::{DEFAULT_ENDPOINT, SessionOptions, close_session, open_session};
use estimator::MapMode;
use monitoring::{LogFormat, MonitoringServer, start_log};
use onboard::arguments::{CalibrationArguments, INPUT, MAP, OUTPUT};
use onboard::{
    EndedLost, MapLink, RobotArguments, RobotMetrics, StopSignal, progress, run_robot_until, stdout,
};
use prometheus_client::registry::Registry;
use sensors::Recording;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::ExitCode;
use tracing_subscriber::EnvFilter;

/// Log filter: warnings, without Zenoh's about a network that is still being discovered.
const QUIET: &str = "warn,zenoh=error";
/// Log filter in real time: changes of the state and a line a minute as well.
const REALTIME: &str = "warn,zenoh=error,onboard=info";

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
    /// The recording: a folder in the EuRoC layout
    #[arg(long, value_name = "DIR", help_heading = INPUT)]
    sequence: PathBuf,
    /// Calibration
    #[command(flatten)]
    calibration: CalibrationArguments,
    /// Name of the map on the server (not needed with --mode odometry)
    #[arg(long, value_name = "NAME", help_heading = MAP)]
    map: Option<String>,
    /// Endpoint of the map server or of a router [default: tcp/127.0.0.1:7447]
    #[arg(long, value_name = "ENDPOINT", help_heading = MAP)]
    connect: Vec<String>,
    /// Zenoh configuration file (JSON5)
    #[arg(long, value_name = "FILE", help_heading = MAP)]
    zenoh_config: Option<PathBuf>,
    /// Namespace of the fleet
    #[arg(long, value_name = "PREFIX", help_heading = MAP)]
    namespace: Option<String>,
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
    let arguments = Arguments::parse();
    let quiet = if arguments.robot.realtime { REALTIME } else { QUIET };
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(quiet));
    start_log(filter, arguments.log_format);
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
            let session =
                runtime.block_on(open_session(&options)).context("the Zenoh session cannot be opened")?;
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
        print!("{}", progress::report(&outcome.summary));
        println!("written to {}", arguments.robot.out.display());
    }
    if let Some(monitoring) = monitoring {
        runtime.block_on(monitoring.stop());
    }
    if let Some(session) = session {
        runtime.block_on(close_session(&session));
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
