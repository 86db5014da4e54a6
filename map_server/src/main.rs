//! `map_server`: serves maps over Zenoh.

#![cfg_attr(test, allow(clippy::unwrap_used))]

mod background;
mod databases;
mod released;
mod status_line;

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, bail};
use client::session::{Member, Role};
use client::{close_session, open_session, without_secrets};
use databases::MapSource;
use hand_in::{Inbox, InboxSettings};
use map_server::arguments::Arguments;
use map_server::byte_size::ByteSize;
use map_server::map_argument::MapArgument;
use map_server::state::SledStore;
use map_server::{
    CellChoice, CellService, CellServiceOptions, InboxService, MapServer, ServerOptions, ServerState, Show,
};
use monitoring::{Health, MonitoringServer, monitoring_routes, start_log};
use prometheus_client::registry::Registry;
use released::open_store;
use releases::{ReleaseChoice, ReleasePlace};
use status_line::StatusLine;
use tokio::time::MissedTickBehavior;
use tracing_subscriber::EnvFilter;

/// Reading a map leaves holes that the allocator of glibc keeps: twice what the map holds.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// How long the end of the program waits for threads that are still busy: a release that is fetched, a query that was abandoned.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_millis(500);
/// From a signal to the end of the program, whatever still waits then: nothing of a server is on its way to a disk that would
/// not be made again.
const STOP_TIME: Duration = Duration::from_millis(2800);

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
            eprintln!("error: {}", client::error_line(error.as_ref()));
            ExitCode::FAILURE
        }
    }
}

async fn serve() -> anyhow::Result<()> {
    let arguments = Arguments::read();
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
    let state = open_state(arguments.state.as_deref()).await;
    let mut maps = Vec::with_capacity(sources.len());
    for source in &sources {
        tokio::select! {
            map = source.load(state.as_ref()) => maps.push(map?),
            signal = &mut stopped => {
                tracing::info!("{signal}: stopping before the maps were loaded");
                return end_in_time();
            }
        }
    }
    let session_options = arguments.session.serving();
    let session = tokio::select! {
        session = open_session(&session_options) => session?,
        signal = &mut stopped => {
            tracing::info!("{signal}: stopping before the session was open");
            return end_in_time();
        }
    };
    let mut options = ServerOptions::default();
    options.name = name;
    if let Some(workers) = arguments.workers {
        options.workers = usize::from(workers);
    }
    options.cell_memory = arguments.memory.map(|ByteSize(bytes)| bytes);
    options.draws_cells = arguments.http.is_some();
    options.state = state;
    let server = MapServer::start(session.clone(), maps, options).await?;
    let services = serve_cells(&server, &arguments, by_cells, &cache).await?;
    let inbox = take_sessions(&session, &arguments).await?;
    let monitoring = match arguments.monitoring {
        Some(address) => Some(start_monitoring(address, &server).await?),
        None => None,
    };
    let show = match arguments.http {
        Some(address) => Some(show_maps(address, &session, &server, &arguments).await.context("--http")?),
        None => None,
    };
    tracing::info!("ready; Ctrl-C stops");

    let signal = serve_until(&mut stopped, &mut reload, &arguments, &sources, &server, show.as_ref()).await;
    tracing::info!("{signal}: stopping");
    end_in_time()?;
    if let Some(show) = show {
        show.stop().await;
    }
    if let Some(monitoring) = monitoring {
        monitoring.stop().await;
    }
    for service in services {
        service.stop().await;
    }
    if let Some(inbox) = inbox {
        inbox.stop().await?;
    }
    server.stop().await?;
    close_session(&session).await;
    Ok(())
}

/// Shows the maps in the browser, and of those that have releases what changed.
async fn show_maps(
    address: SocketAddr,
    session: &zenoh::Session,
    server: &MapServer,
    arguments: &Arguments,
) -> anyhow::Result<Show> {
    let names = arguments.maps.iter().map(|map| map.name.as_str());
    let beside = monitoring_routes(registry_of(server), serving);
    let mut show = Show::start(address, session, server, names, beside).await?;
    for map in &arguments.maps {
        if !map.is_released() {
            show.show_images(&map.name, Path::new(&map.place)).await;
            continue;
        }
        let ReleasePlace { url, choice } = map.releases();
        let store = open_store(&url, arguments.release_key.as_ref())?;
        show.follow_releases(&map.name, store, choice, Duration::from_secs(arguments.watch_releases));
    }
    Ok(show)
}

/// Serves until a signal comes, which it returns: with each SIGHUP the maps are loaded again, and from time to time those that
/// have releases.
async fn serve_until<S>(
    mut stopped: impl Future<Output = S> + Unpin,
    reload: &mut ReloadSignal,
    arguments: &Arguments,
    sources: &[MapSource],
    server: &MapServer,
    show: Option<&Show>,
) -> S {
    let has_releases = sources.iter().any(MapSource::has_releases);
    let mut watch = tokio::time::interval(Duration::from_secs(arguments.watch_releases));
    watch.set_missed_tick_behavior(MissedTickBehavior::Delay);
    watch.reset();
    let mut status_line = StatusLine::new();
    loop {
        tokio::select! {
            signal = &mut stopped => break signal,
            () = status_line.is_due() => {
                status_line.log(server);
                continue;
            }
            () = reload.recv() => {
                tracing::info!("SIGHUP: reloading the maps");
                sources.iter().for_each(MapSource::look_again);
                tokio::select! {
                    signal = &mut stopped => break signal,
                    () = databases::reload(server, sources.iter()) => {}
                }
            }
            _ = watch.tick(), if has_releases => {
                let released = sources.iter().filter(|source| source.has_releases());
                tokio::select! {
                    signal = &mut stopped => break signal,
                    () = databases::reload(server, released) => {}
                }
            }
        }
        if let Some(show) = show {
            for map in &arguments.maps {
                if show.update(&map.name, server).await && !map.is_released() {
                    show.show_images(&map.name, Path::new(&map.place)).await;
                }
            }
        }
    }
}

/// Ends the program after [`STOP_TIME`] where it has not ended by itself.
fn end_in_time() -> anyhow::Result<()> {
    let end = || {
        std::thread::sleep(STOP_TIME);
        tracing::warn!("not everything ended within {STOP_TIME:?}; ending now");
        std::process::exit(0);
    };
    std::thread::Builder::new().name("end".into()).spawn(end).context("no thread could be started")?;
    Ok(())
}

/// Serves maps by the cells that `--cells` names.
async fn serve_cells(
    server: &MapServer,
    arguments: &Arguments,
    maps: Vec<&MapArgument>,
    cache: &Path,
) -> anyhow::Result<Vec<CellService>> {
    let mut services = Vec::new();
    for argument in maps {
        let (name, ReleasePlace { url, choice }) = (&argument.name, argument.releases());
        if choice != ReleaseChoice::Newest {
            bail!(
                "map {name}: --cells serves the newest live release only; serve {choice} as a whole, by a server without --cells"
            );
        }
        let mut options = CellServiceOptions::new(cache.join(name));
        options.choice = arguments.cells.clone().unwrap_or(CellChoice::Auto);
        options.replicas = usize::from(arguments.replicas);
        options.watch = Duration::from_secs(arguments.watch_releases);
        let served = async {
            let store = open_store(&url, arguments.release_key.as_ref())?;
            CellService::start(server, name, store, options).await
        };
        services.push(served.await.with_context(|| format!("map {name} cannot be served"))?);
    }
    Ok(services)
}

/// Takes sessions into the folder that `--inbox` names.
async fn take_sessions(
    session: &zenoh::Session,
    arguments: &Arguments,
) -> anyhow::Result<Option<InboxService>> {
    let Some(folder) = &arguments.inbox else { return Ok(None) };
    let settings = InboxSettings {
        folder: folder.clone(),
        bytes_of_robot: arguments.inbox_robot_limit.0 as u64,
        bytes_in_all: arguments.inbox_limit.0 as u64,
        keys: arguments.robot_keys.clone(),
    };
    if settings.keys.is_none() && arguments.session.secure.is_none() {
        tracing::warn!(
            "--inbox without --robot-keys and --secure: anybody in the network can hand sessions in"
        );
    }
    let inbox = Inbox::open(settings).context("--inbox")?;
    let maps = arguments.maps.iter().map(|map| map.name.as_str());
    Ok(Some(InboxService::start(session, maps, inbox).await.context("--inbox")?))
}

/// The user's cache folder, or where there is no user the folder for temporary files.
fn default_cache() -> PathBuf {
    let folder = user_folder("XDG_CACHE_HOME", ".cache");
    folder.unwrap_or_else(std::env::temp_dir).join("driftless/releases")
}

/// A folder of the user.
///
/// # Arguments
/// * `variable`: names it, where it is set.
/// * `in_home`: where it is otherwise.
fn user_folder(variable: &str, in_home: &str) -> Option<PathBuf> {
    let named = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    named(variable).or_else(|| named("HOME").map(|home| home.join(in_home)))
}

/// Opens the database of this server; a server without one serves all the same.
async fn open_state(folder: Option<&Path>) -> Option<Arc<ServerState>> {
    let in_user =
        || user_folder("XDG_STATE_HOME", ".local/state").map(|user| user.join("driftless/map_server"));
    let folder = folder.map(Path::to_owned).or_else(in_user)?;
    // A thread of its own: sled panics on some damaged files.
    let opening = tokio::task::spawn_blocking(move || SledStore::open(&folder));
    let opened = opening.await.map_err(anyhow::Error::from).and_then(|opened| Ok(opened?));
    let state = opened.inspect_err(|error| tracing::warn!("nothing is kept for the next start: {error:#}"));
    Some(Arc::new(ServerState::new(state.ok()?)))
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
