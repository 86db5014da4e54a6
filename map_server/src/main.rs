//! `map_server`: serves maps over Zenoh.

use std::io::IsTerminal as _;
use std::path::PathBuf;
use std::process::ExitCode;
use std::str::FromStr;
use std::sync::Arc;

use anyhow::Context;
use clap::Parser;
use map_server::{LoadedMap, MapServer, ServedMap, ServerOptions, SledStore};
use protocol::session::{DEFAULT_ENDPOINT, SessionOptions, close_session, open_session};
use tracing_subscriber::EnvFilter;

const EXAMPLES: &str = "\
Examples:
  Serve one map to programs on this machine:
    map_server --map hall=maps/hall.db

  Serve two maps to the robots of the fleet `north` in the local network:
    map_server --map hall=maps/hall.db --map yard=maps/yard.db --listen tcp/0.0.0.0:7447 --namespace north

  Join a network with a Zenoh router instead of listening:
    map_server --map hall=maps/hall.db --connect tcp/10.0.0.1:7447

  Then, from another shell:
    driftless query --map hall --features frame.csv        one image against the map
    onboard --sequence SEQ --map hall --out out            a recorded run, localized

Maps are made by `driftless build-map` or `driftless import-map`. A map is read when the server starts; restart the
server to serve a newer one. Ctrl-C or SIGTERM stops it gracefully.";

/// Serves maps to robots over Zenoh: which keyframes does an image show, and where was it taken?
#[derive(Parser, Debug)]
#[command(version, after_long_help = EXAMPLES, after_help = "Use --help for examples.")]
struct Arguments {
    /// A map to serve and the name that robots call it by; may be given several times.
    #[arg(long = "map", value_name = "NAME=DB", required = true)]
    maps: Vec<MapArgument>,

    /// Where to listen, for example tcp/0.0.0.0:7447 for the whole network [default: tcp/127.0.0.1:7447, unless
    /// --connect or --config is given]. May be given several times.
    #[arg(long, value_name = "ENDPOINT")]
    listen: Vec<String>,

    /// A Zenoh router or peer to connect to; tried again until it answers. May be given several times.
    #[arg(long, value_name = "ENDPOINT")]
    connect: Vec<String>,

    /// A Zenoh configuration file (JSON5), for TLS, users, access control; --listen, --connect and --namespace
    /// override it.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,

    /// Prefix of all keys: one namespace is one fleet.
    #[arg(long, value_name = "NAME")]
    namespace: Option<String>,

    /// Name of this server among others [default: the id of its Zenoh session].
    #[arg(long, value_name = "NAME")]
    name: Option<String>,

    /// Queries that are worked on at the same time [default: the number of processors].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    workers: Option<u16>,

    /// What to log: error, warn, info, debug, or a filter like map_server=debug,zenoh=warn.
    #[arg(long, value_name = "FILTER", default_value = "info,zenoh=warn")]
    log: String,
}

/// `NAME=DB`
#[derive(Clone, Debug)]
struct MapArgument {
    name: String,
    database: PathBuf,
}

impl FromStr for MapArgument {
    type Err = String;

    fn from_str(text: &str) -> Result<MapArgument, String> {
        let Some((name, database)) = text.split_once('=') else {
            return Err("write the map's name and its database as NAME=DB, like hall=maps/hall.db".to_owned());
        };
        protocol::keys::validate_name(name).map_err(|error| error.to_string())?;
        if database.is_empty() {
            return Err(format!("the database of map {name} is missing: write {name}=PATH"));
        }
        Ok(MapArgument { name: name.to_owned(), database: PathBuf::from(database) })
    }
}

#[tokio::main]
async fn main() -> ExitCode {
    match serve().await {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

async fn serve() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    let filter = EnvFilter::try_new(&arguments.log)
        .with_context(|| format!("--log {:?} is not a log filter; try --log info", arguments.log))?;
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .init();
    // Before anything takes long, so that a stop during loading is not lost.
    let stopped = stop_signal()?;
    tokio::pin!(stopped);

    let maps = arguments.maps.iter().map(load).collect::<anyhow::Result<Vec<_>>>()?;
    let session_options = session_options(&arguments);
    let session = open_session(&session_options).await?;
    let mut options = ServerOptions { name: arguments.name.clone(), ..ServerOptions::default() };
    if let Some(workers) = arguments.workers {
        options.workers = usize::from(workers);
    }
    let server = MapServer::start(session.clone(), maps, options).await?;
    tracing::info!(
        listen = ?session_options.listen,
        connect = ?session_options.connect,
        namespace = session_options.namespace.as_deref().unwrap_or("(none)"),
        "ready; Ctrl-C stops"
    );

    let signal = stopped.await;
    tracing::info!("{signal}: stopping");
    server.stop().await?;
    close_session(&session).await;
    Ok(())
}

/// Reads a map into memory. The database is closed again, so that other programs can look at it.
fn load(argument: &MapArgument) -> anyhow::Result<ServedMap> {
    let MapArgument { name, database } = argument;
    let store = SledStore::open(database).with_context(|| format!("map {name} cannot be served"))?;
    let map = LoadedMap::load(&store).with_context(|| format!("map {name} cannot be served"))?;
    tracing::info!(
        name,
        database = %database.display(),
        version = map.info().version,
        keyframes = map.keyframe_count(),
        landmarks = map.landmark_count(),
        "loaded a map"
    );
    if map.damaged_records() > 0 {
        let damaged = map.damaged_records();
        tracing::warn!(name, "{damaged} damaged records were left out; build or import the map again");
    }
    if map.keyframe_count() == 0 {
        tracing::warn!(name, "the map holds no keyframes: nothing will ever match");
    }
    Ok(ServedMap { name: name.clone(), map: Arc::new(map) })
}

fn session_options(arguments: &Arguments) -> SessionOptions {
    let mut options = SessionOptions {
        config_file: arguments.config.clone(),
        listen: arguments.listen.clone(),
        connect: arguments.connect.clone(),
        namespace: arguments.namespace.clone(),
        ..SessionOptions::default()
    };
    if options.listen.is_empty() && options.connect.is_empty() && options.config_file.is_none() {
        options.listen.push(DEFAULT_ENDPOINT.to_owned());
    }
    options
}

/// Ends when the process is asked to stop; says by what.
#[cfg(unix)]
fn stop_signal() -> anyhow::Result<impl Future<Output = &'static str>> {
    use tokio::signal::unix::{SignalKind, signal};
    let mut interrupt = signal(SignalKind::interrupt()).context("SIGINT cannot be handled")?;
    let mut terminate = signal(SignalKind::terminate()).context("SIGTERM cannot be handled")?;
    Ok(async move {
        tokio::select! {
            _ = interrupt.recv() => "SIGINT",
            _ = terminate.recv() => "SIGTERM",
        }
    })
}

/// Ends when the process is asked to stop; says by what.
#[cfg(not(unix))]
fn stop_signal() -> anyhow::Result<impl Future<Output = &'static str>> {
    Ok(async {
        match tokio::signal::ctrl_c().await {
            Ok(()) => "Ctrl-C",
            Err(_) => std::future::pending().await,
        }
    })
}
