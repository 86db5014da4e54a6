//! `map_server`: serves maps over Zenoh.

mod byte_size;
mod databases;
mod released;
mod status_line;

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Context, bail};
use byte_size::ByteSize;
use clap::Parser;
use client::session::{Member, Role};
use client::{SessionArguments, close_session, open_session, without_secrets};
use databases::{MapArgument, MapSource};
use map_server::{CellChoice, CellService, CellServiceOptions, MapServer, ServerOptions, Show};
use monitoring::{Health, LogFormat, MonitoringServer, monitoring_routes, start_log};
use prometheus_client::registry::Registry;
use released::open_store;
use releases::ReleaseKey;
use status_line::StatusLine;
use tokio::time::MissedTickBehavior;
use tracing_subscriber::EnvFilter;

/// Reading a map leaves holes that the allocator of glibc keeps: twice what the map holds.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

const EXAMPLES: &str = "\
Examples:
  Serve one map to programs on this machine:
    map_server --map hall=maps/hall.db

  Serve two maps to the robots of the fleet `north` in the local network:
    map_server --map hall=maps/hall.db --map yard=maps/yard.db --listen tcp/0.0.0.0:7447 --namespace north

  Connect to a Zenoh router instead of listening:
    map_server --map hall=maps/hall.db --connect tcp/10.0.0.1:7447

  Show the map and the robots in the browser:
    map_server --map hall=maps/hall.db --http 127.0.0.1:8080

  Serve the newest release of a map, and follow new ones (see `driftless publish-map`):
    map_server --map city=s3://bucket/city --cache /var/cache/driftless

  Serve it by several servers that share its cells, each cell at two of them (see the page Releases of the book):
    map_server --map city=s3://bucket/city --cells auto --connect tcp/10.0.0.1:7447
    map_server --map city=s3://bucket/city --cells auto --connect tcp/10.0.0.1:7447 --memory 8G

  Then, in another shell:
    driftless query --map hall --features frame.csv        one image against the map
    onboard --sequence SEQ --map hall --out out            a recorded run, localized

  Serve a new version of a map without a restart; robots are notified and keep their pose:
    driftless import-map text --map maps/hall.db --force   or build-map, into the served database
    kill -HUP PID                                          of the server, which reloads its databases

Maps are built by `driftless build-map` or imported by `driftless import-map`. A map is loaded when the server starts,
and at SIGHUP if its version changed; if that fails, the previous version continues to be served and the log says why.
Another map than the served one (see `driftless map-info`: identity) is not loaded at SIGHUP: restart the server for it.
Ctrl-C or SIGTERM stops the server gracefully.";

/// Log filter: of Zenoh, warnings, and who was let in or refused.
const QUIET: &str = "info,zenoh=warn,zenoh_link_tls=debug,zenoh::net::routing::interceptor=info";

/// Serves maps to robots over Zenoh: matches images with keyframes and estimates where they were taken.
#[derive(Parser, Debug)]
#[command(version, after_long_help = EXAMPLES, after_help = "Use --help for examples.")]
struct Arguments {
    /// A map to serve: its name in keys and its database, or the folder or URL of its releases (/srv/city, s3://bucket/city; see
    /// `driftless publish-map`). A folder that may be away when the server starts is given as file:///srv/city. May be given
    /// several times.
    #[arg(long = "map", value_name = "NAME=DB|FOLDER|URL", required = true)]
    maps: Vec<MapArgument>,

    /// Folder for what is fetched of releases: a restart serves it when the store is away [default: driftless/releases in
    /// the user's cache folder].
    #[arg(long, value_name = "DIR")]
    cache: Option<PathBuf>,

    /// Look for new releases after this time, s.
    #[arg(long, value_name = "SECONDS", default_value_t = 30, value_parser = clap::value_parser!(u64).range(1..))]
    watch_releases: u64,

    /// Take only releases that are signed with this key: a file of driftless release-key or minisign, or its line.
    #[arg(long, value_name = "FILE|KEY")]
    release_key: Option<ReleaseKey>,

    /// Serve these cells of maps from releases, and leave the others to other servers: numbers like 0-3,7 (see
    /// `driftless list-releases --cells`), or auto for a share of them, which changes as servers come and go.
    #[arg(long, value_name = "CELLS|auto")]
    cells: Option<CellChoice>,

    /// With --cells auto: have each cell at so many servers.
    #[arg(long, value_name = "N", default_value_t = 2, requires = "cells", value_parser = clap::value_parser!(u16).range(1..))]
    replicas: u16,

    /// With --cells: memory that loaded cells may take, like 8G or 512M. Further cells are on disk, in --cache, and loaded when they
    /// are asked for; those that were not asked for longest give way [default: all cells are in memory].
    #[arg(long, value_name = "SIZE", requires = "cells")]
    memory: Option<ByteSize>,

    /// How the server is connected [default: --listen tcp/127.0.0.1:7447].
    #[command(flatten)]
    session: SessionArguments,

    /// Name of this server among others [default: that of its certificate, or the id of its Zenoh session].
    #[arg(long, value_name = "NAME")]
    name: Option<String>,

    /// Queries answered at the same time [default: the number of processors].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    workers: Option<u16>,

    /// Log filter: error, warn, info, debug, or per module, like map_server=debug,zenoh=warn.
    #[arg(long, value_name = "FILTER", default_value = QUIET)]
    log: String,

    /// Format of the log: text for people, json for programs, one object a line.
    #[arg(long, value_name = "FORMAT", default_value_t)]
    log_format: LogFormat,

    /// Address of an HTTP server of metrics (/metrics, for Prometheus) and health (/health), for example
    /// 127.0.0.1:9464. It knows no users: use an address that only operators reach.
    #[arg(long, value_name = "ADDRESS:PORT")]
    monitoring: Option<SocketAddr>,

    /// Address of an HTTP server of the live map in the browser (/), for example 127.0.0.1:8080, with metrics and health
    /// beside it. It knows no users: an address other than loopback shows the map and all robots to everybody who reaches it.
    #[arg(long, value_name = "ADDRESS:PORT")]
    http: Option<SocketAddr>,
}

/// How long the end of the program waits for a release that is being fetched.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_secs(2);

fn main() -> ExitCode {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build();
    let served = runtime.context("no threads could be started").and_then(|runtime| {
        let served = runtime.block_on(serve());
        runtime.shutdown_timeout(SHUTDOWN_TIMEOUT);
        served
    });
    match served {
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
    start_log(without_secrets(filter), arguments.log_format);
    // Before maps are loaded, so that a signal meanwhile is not lost.
    let stopped = stop_signal()?;
    tokio::pin!(stopped);

    let mut reload = ReloadSignal::new()?;

    let name = match &arguments.session.secure {
        Some(folder) => Some(Member::expect(folder, Role::MapServer, ("--name", arguments.name.as_deref()))?),
        None => arguments.name.clone(),
    };
    let cache = arguments.cache.clone().unwrap_or_else(default_cache);
    let (by_cells, whole) = arguments.maps_by_cells()?;
    let open = |map: &&MapArgument| MapSource::open(map, &cache, arguments.release_key.as_ref());
    let sources = whole.iter().map(open).collect::<anyhow::Result<Vec<_>>>()?;
    let mut maps = Vec::with_capacity(sources.len());
    for source in &sources {
        maps.push(source.load().await?);
    }
    let session_options = arguments.session.serving();
    let session = tokio::select! {
        session = open_session(&session_options) => session?,
        signal = &mut stopped => {
            tracing::info!("{signal}: stopping before the session was open");
            return Ok(());
        }
    };
    let mut options = ServerOptions::default();
    options.name = name;
    if let Some(workers) = arguments.workers {
        options.workers = usize::from(workers);
    }
    options.cell_memory = arguments.memory.map(|ByteSize(bytes)| bytes);
    options.draws_cells = arguments.http.is_some();
    let server = MapServer::start(session.clone(), maps, options).await?;
    let services = serve_cells(&server, &arguments, by_cells, &cache).await?;
    let monitoring = match arguments.monitoring {
        Some(address) => Some(start_monitoring(address, &server).await?),
        None => None,
    };
    let show = match arguments.http {
        Some(address) => {
            let names = arguments.maps.iter().map(|map| map.name.as_str());
            let beside = monitoring_routes(registry_of(&server), serving);
            Some(Show::start(address, &session, &server, names, beside).await.context("--http")?)
        }
        None => None,
    };
    tracing::info!("ready; Ctrl-C stops");

    let has_releases = sources.iter().any(MapSource::has_releases);
    let mut watch = tokio::time::interval(Duration::from_secs(arguments.watch_releases));
    watch.set_missed_tick_behavior(MissedTickBehavior::Delay);
    watch.reset();
    let mut status_line = StatusLine::new();
    let signal = loop {
        tokio::select! {
            signal = &mut stopped => break signal,
            () = status_line.is_due() => {
                status_line.log(&server);
                continue;
            }
            () = reload.recv() => {
                tracing::info!("SIGHUP: reloading the maps");
                tokio::select! {
                    signal = &mut stopped => break signal,
                    () = databases::reload(&server, sources.iter()) => {}
                }
            }
            _ = watch.tick(), if has_releases => {
                let released = sources.iter().filter(|source| source.has_releases());
                tokio::select! {
                    signal = &mut stopped => break signal,
                    () = databases::reload(&server, released) => {}
                }
            }
        }
        if let Some(show) = &show {
            for map in &arguments.maps {
                show.update(&map.name, &server).await;
            }
        }
    };
    tracing::info!("{signal}: stopping");
    if let Some(show) = show {
        show.stop().await;
    }
    if let Some(monitoring) = monitoring {
        monitoring.stop().await;
    }
    for service in services {
        service.stop().await;
    }
    server.stop().await?;
    close_session(&session).await;
    Ok(())
}

impl Arguments {
    /// The maps of which this server has some cells, and those that it has as a whole.
    fn maps_by_cells(&self) -> anyhow::Result<(Vec<&MapArgument>, Vec<&MapArgument>)> {
        let (by_cells, whole): (Vec<_>, Vec<_>) =
            self.maps.iter().partition(|map| self.cells.is_some() && map.is_released());
        if self.cells.is_some() && by_cells.is_empty() {
            bail!(
                "--cells is for maps from releases (--map NAME=FOLDER or NAME=URL), and there is none: publish it with driftless publish-map"
            );
        }
        Ok((by_cells, whole))
    }
}

/// Serves maps by the cells that `--cells` names.
async fn serve_cells(
    server: &MapServer,
    arguments: &Arguments,
    maps: Vec<&MapArgument>,
    cache: &Path,
) -> anyhow::Result<Vec<CellService>> {
    let mut services = Vec::new();
    for MapArgument { name, place } in maps {
        let mut options = CellServiceOptions::new(cache.join(name));
        options.choice = arguments.cells.clone().unwrap_or(CellChoice::Auto);
        options.replicas = usize::from(arguments.replicas);
        options.watch = Duration::from_secs(arguments.watch_releases);
        let served = async {
            let store = open_store(place, arguments.release_key.as_ref())?;
            CellService::start(server, name, store, options).await
        };
        services.push(served.await.with_context(|| format!("map {name} cannot be served"))?);
    }
    Ok(services)
}

/// The user's cache folder, or where there is no user the folder for temporary files.
fn default_cache() -> PathBuf {
    let named = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    let folder = named("XDG_CACHE_HOME").or_else(|| named("HOME").map(|home| home.join(".cache")));
    folder.unwrap_or_else(std::env::temp_dir).join("driftless/releases")
}

/// Serves the metrics of a server.
async fn start_monitoring(address: SocketAddr, server: &MapServer) -> anyhow::Result<MonitoringServer> {
    let started = MonitoringServer::start(address, registry_of(server), serving).await;
    started.context("--monitoring")
}

fn registry_of(server: &MapServer) -> Registry {
    let mut registry = Registry::with_prefix("driftless");
    server.register_metrics(&mut registry);
    registry
}

/// A server is well as long as it serves.
fn serving() -> Health {
    Health::well("serving")
}

/// The signal that requests a reload of the databases.
#[cfg(unix)]
struct ReloadSignal(tokio::signal::unix::Signal);

#[cfg(unix)]
impl ReloadSignal {
    fn new() -> anyhow::Result<ReloadSignal> {
        use tokio::signal::unix::{SignalKind, signal};
        signal(SignalKind::hangup()).map(ReloadSignal).context("SIGHUP cannot be handled")
    }

    async fn recv(&mut self) {
        if self.0.recv().await.is_none() {
            std::future::pending::<()>().await;
        }
    }
}

/// There is no such signal on this system.
#[cfg(not(unix))]
struct ReloadSignal;

#[cfg(not(unix))]
impl ReloadSignal {
    fn new() -> anyhow::Result<ReloadSignal> {
        Ok(ReloadSignal)
    }

    async fn recv(&mut self) {
        std::future::pending::<()>().await;
    }
}

/// Completes when the process receives a signal to stop; returns its name.
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

/// Completes when the process receives a signal to stop; returns its name.
#[cfg(not(unix))]
fn stop_signal() -> anyhow::Result<impl Future<Output = &'static str>> {
    Ok(async {
        match tokio::signal::ctrl_c().await {
            Ok(()) => "Ctrl-C",
            Err(_) => std::future::pending().await,
        }
    })
}
