//! Starting a server, replacing a map, stopping.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, PoisonError, RwLock};
use std::time::Duration;

use prometheus_client::registry::Registry;
use protocol::{MapChangeNotice, StatedChange, Validate as _, keys};
use recognition::{LoadedMap, RecognitionOptions};
use tokio::sync::MutexGuard;
use tokio::sync::broadcast::Receiver;
use zenoh::Session;
use zenoh::liveliness::LivelinessToken;
use zenoh::query::{Query, Queryable};

use crate::cells::{CellDrawings, CellMemory};
use crate::change;
use crate::error::ServeError;
use crate::handlers;
use crate::host::Host;
use crate::images::ImageLocalizer;
use crate::kind::Kind;
use crate::metrics::{ServerMetrics, ServerStatistics};
use crate::names;
use crate::options::ServerOptions;
use crate::queue::{Job, Queue, Target};
use crate::reports::{QueryReport, ReportSender};
use crate::senders::Senders;
use crate::served_map::{MapSlot, ServedMap};
use crate::state::{MapVersion, ServerState, note_served};
use crate::workers::Workers;

/// How long [`MapServer::stop`] waits for queries that are being answered.
const STOP_TIMEOUT: Duration = Duration::from_millis(1500);

/// A running map server.
///
/// It uses the session that it was started with, and leaves it open when it stops.
///
/// # Example
/// ```
/// use client::{MapClient, SessionOptions, close_session, open_session};
/// use map::{MapContents, MapMetadata};
/// use map_server::{MapServer, ServedMap, ServerOptions};
/// use protocol::DescriptorKind;
/// use recognition::LoadedMap;
/// use std::sync::Arc;
/// use std::time::{Duration, Instant};
///
/// # #[tokio::main]
/// # async fn main() -> Result<(), Box<dyn std::error::Error + Send + Sync>> {
/// let contents = MapContents::empty(MapMetadata::new("hall", "example", DescriptorKind::Binary, 32));
/// let map = Arc::new(LoadedMap::from_contents(contents)?);
/// let session = open_session(&SessionOptions::default()).await?;
/// let maps = vec![ServedMap { name: "hall".into(), map }];
/// let server = MapServer::start(session.clone(), maps, ServerOptions::default()).await?;
///
/// let hall = MapClient::new(session.clone(), "hall")?;
/// let info = hall.info(Instant::now() + Duration::from_secs(5)).await?;
/// assert_eq!((info.name.as_str(), info.keyframes), ("hall", 0));
///
/// server.stop().await?;
/// close_session(&session).await;
/// # Ok(())
/// # }
/// ```
pub struct MapServer {
    session: Session,
    /// Its name among others.
    server: String,
    maps: Arc<BTreeMap<String, Arc<MapSlot>>>,
    /// Of all maps, those that are served by cells among them.
    names: Arc<RwLock<BTreeSet<String>>>,
    token: LivelinessToken,
    queryables: Vec<Queryable<()>>,
    queue: Arc<Queue>,
    metrics: Arc<ServerMetrics>,
    reports: ReportSender,
    recognition: RecognitionOptions,
    cell_memory: Arc<CellMemory>,
    drawings: Option<Arc<CellDrawings>>,
    state: Option<Arc<ServerState>>,
    workers: Workers,
}

impl MapServer {
    /// Serves maps in an open session. When this returns, all queryables and then the liveliness token are declared.
    ///
    /// Needs a multi-threaded tokio runtime.
    ///
    /// # Errors
    /// [`ServeError::Name`], [`ServeError::NameTaken`], [`ServeError::DuplicateMap`], [`ServeError::Threads`], [`ServeError::Zenoh`]; nothing remains
    /// declared.
    pub async fn start(
        session: Session,
        maps: Vec<ServedMap>,
        options: ServerOptions,
    ) -> Result<MapServer, ServeError> {
        let server = options.name.clone().unwrap_or_else(|| session.zid().to_string());
        let token_key = keys::map_server(&server)?;
        let mut served = BTreeMap::new();
        for map in maps {
            keys::validate_name(&map.name)?;
            let name = map.name.clone();
            if served.insert(name.clone(), Arc::new(MapSlot::new(map))).is_some() {
                return Err(ServeError::DuplicateMap { name });
            }
        }
        let maps = Arc::new(served);

        names::wait_until_free(&session, &server, &token_key).await?;
        let metrics = Arc::new(ServerMetrics::default());
        for map in maps.values() {
            let loaded = map.current();
            metrics.note_map(&map.name, loaded.keyframe_count(), loaded.info().version);
            note_served(options.state.as_ref(), &map.name, MapVersion::of(&loaded)).await;
        }
        let reports = ReportSender::new();
        let senders = Senders::follow(&session).await;
        let (length, bytes) = (options.queue_length, options.queue_bytes);
        let queue = Queue::new(length, bytes, Arc::clone(&metrics), reports.clone(), senders);
        let workers =
            Workers::start(&queue, options.workers, &options.recognition).map_err(ServeError::Threads)?;
        let names = Arc::new(RwLock::new(maps.keys().cloned().collect()));
        let mut queryables = Vec::new();
        for map in maps.values() {
            for kind in Kind::ALL {
                let key = kind.key(&map.name)?;
                let (queue, map) = (Arc::clone(&queue), Arc::clone(map));
                let callback = move |query: Query| {
                    queue.put(Job::new(query, Target::Map(kind, Arc::clone(&map))));
                };
                queryables.push(session.declare_queryable(key).callback(callback).complete(true).await?);
            }
        }
        for kind in Kind::ALL {
            let known = Arc::clone(&names);
            let callback = move |query: Query| {
                handlers::refuse_unknown_map(&query, &known.read().unwrap_or_else(PoisonError::into_inner));
            };
            queryables.push(session.declare_queryable(kind.key_of_any_map()).callback(callback).await?);
        }
        let token = session.liveliness().declare_token(token_key).await?;
        tracing::info!(
            server,
            maps = maps.keys().map(String::as_str).collect::<Vec<_>>().join(", "),
            "serving"
        );
        let recognition = options.recognition;
        let cell_memory = CellMemory::new(options.cell_memory, Arc::clone(&metrics));
        Ok(MapServer {
            session,
            server,
            maps,
            names,
            token,
            queryables,
            queue,
            metrics,
            reports,
            recognition,
            cell_memory,
            drawings: options.draws_cells.then(CellDrawings::new),
            state: options.state,
            workers,
        })
    }

    /// What a map that is served by cells shares with this server.
    pub(crate) fn host(&self) -> Host {
        Host {
            session: self.session.clone(),
            server: self.server.clone(),
            queue: Arc::clone(&self.queue),
            metrics: Arc::clone(&self.metrics),
            options: self.recognition.clone(),
            memory: Arc::clone(&self.cell_memory),
            drawings: self.drawings.clone(),
            state: self.state.clone(),
        }
    }

    /// Takes a name for a map that is served by cells.
    pub(crate) fn reserve(&self, name: &str) -> Result<(), ServeError> {
        let mut names = self.names.write().unwrap_or_else(PoisonError::into_inner);
        if names.insert(name.to_owned()) {
            Ok(())
        } else {
            Err(ServeError::DuplicateMap { name: name.to_owned() })
        }
    }

    /// The map that is being served under a name; `None` for one that this server does not have.
    pub fn served(&self, name: &str) -> Option<Arc<LoadedMap>> {
        self.maps.get(name).map(|served| served.current())
    }

    /// What becomes of queries for a match or a pose from now on. A receiver that is too slow misses the oldest.
    pub fn reports(&self) -> Receiver<QueryReport> {
        self.reports.subscribe()
    }

    /// Localizes images in the maps that are being served as a whole, beside the queue of queries.
    pub fn images(&self) -> ImageLocalizer {
        let names = Arc::clone(&self.names);
        ImageLocalizer::of_slots(Arc::clone(&self.maps), names, self.recognition.clone())
    }

    /// Counters since the start.
    pub fn statistics(&self) -> ServerStatistics {
        self.metrics.statistics()
    }

    pub(crate) fn drawings(&self) -> Option<Arc<CellDrawings>> {
        self.drawings.clone()
    }

    pub(crate) fn metrics(&self) -> Arc<ServerMetrics> {
        Arc::clone(&self.metrics)
    }

    /// Registers the metrics of this server with names that begin with `map_server`.
    pub fn register_metrics(&self, registry: &mut Registry) {
        self.metrics.register(registry);
    }

    /// Replaces a map by another version of it while it is served and publishes the difference on `map/{map}/changes`. Queries in progress are
    /// answered with the previous map. As [`MapServer::prepare_replacement`] and [`Replacement::serve`].
    ///
    /// # Errors
    /// As these two.
    pub async fn replace(
        &self,
        name: &str,
        map: Arc<LoadedMap>,
        stated_change: Option<StatedChange>,
    ) -> Result<(), ServeError> {
        self.prepare_replacement(name, map, stated_change).await?.serve().await
    }

    /// Compares another version of a map with the one that is served. The caller can write down what is going to be served before it
    /// answers any query; other replacements of the map wait until this one is served or dropped.
    ///
    /// # Arguments
    /// * `stated_change`: size of the map's motion, if known to the caller; otherwise computed from the keyframes that
    ///   both versions have. One beyond [`protocol::MAX_CHANGE_RAD`] or [`protocol::MAX_CHANGE_M`] counts as unknown.
    ///
    /// # Errors
    /// [`ServeError::UnknownMap`]; [`ServeError::OtherMap`] for a map of another identity: a version that was made in memory
    /// states the identity of the served map in its info; [`ServeError::OldVersion`] for a version that is not newer;
    /// [`ServeError::TaskFailed`] where the comparison panicked. Then the previous version is served as before.
    pub async fn prepare_replacement(
        &self,
        name: &str,
        map: Arc<LoadedMap>,
        stated_change: Option<StatedChange>,
    ) -> Result<Replacement<'_>, ServeError> {
        let slot = self.maps.get(name).ok_or_else(|| ServeError::UnknownMap { name: name.to_owned() })?;
        let changing = slot.changing.lock().await;
        let previous = slot.current();
        let (served_identity, given) = (previous.identity(), map.identity());
        if served_identity != given {
            return Err(ServeError::OtherMap { name: name.to_owned(), served: served_identity, given });
        }
        let (serving, version) = (previous.info().version, map.info().version);
        if version <= serving {
            return Err(ServeError::OldVersion { name: name.to_owned(), served: serving, given: version });
        }
        let comparing = {
            let (name, map) = (name.to_owned(), Arc::clone(&map));
            tokio::task::spawn_blocking(move || change::between(&name, &previous, &map))
        };
        let (mut change, added) = comparing.await.map_err(|error| ServeError::task(&error))?;
        change.stated_change = stated_change.or(change.stated_change).filter(|size| size.validate().is_ok());
        Ok(Replacement { server: self, slot, map, change, added, _changing: changing })
    }

    /// Stops serving: undeclares everything, then answers the queries already received, for at most 1.5 s.
    ///
    /// # Errors
    /// [`ServeError::Zenoh`] if something could not be undeclared, for example in a closed session.
    pub async fn stop(self) -> Result<(), ServeError> {
        let MapServer { token, queryables, metrics, workers, .. } = self;
        let mut result = token.undeclare().await;
        for queryable in queryables {
            let undeclared = queryable.undeclare().await;
            result = result.and(undeclared);
        }
        if tokio::time::timeout(STOP_TIMEOUT, workers.end()).await.is_err() {
            tracing::warn!("abandoned queries that were still being answered after {STOP_TIMEOUT:?}");
        }
        let ServerStatistics { answered, failed, refused, panicked, .. } = metrics.statistics();
        tracing::info!(answered, failed, refused, panicked, "stopped serving");
        Ok(result?)
    }
}

/// A version of a map that can take the place of the one that is served.
#[must_use = "the previous version is served until this one is"]
pub struct Replacement<'server> {
    server: &'server MapServer,
    slot: &'server MapSlot,
    map: Arc<LoadedMap>,
    change: MapChangeNotice,
    /// How many keyframes are new.
    added: usize,
    _changing: MutexGuard<'server, ()>,
}

impl Replacement<'_> {
    /// Notes in the state of the server that the version is served, serves it, and publishes the difference.
    ///
    /// The notice leaves as soon as the new version answers, since robots wait for it for 2 s only; what takes time comes before.
    ///
    /// # Errors
    /// [`ServeError::Zenoh`], [`ServeError::Codec`] if the map was replaced but the notice was not published.
    pub async fn serve(self) -> Result<(), ServeError> {
        let Replacement { server, slot, map, change, added, _changing } = self;
        let name = &slot.name;
        note_served(server.state.as_ref(), name, MapVersion::of(&map)).await;
        let (keyframes, version) = (map.keyframe_count(), change.version);
        // It is large, and given back behind the notice.
        let _former = slot.replace(map);
        server.metrics.note_map(name, keyframes, version);
        tracing::info!(
            name,
            from_version = change.from_version,
            version,
            keyframes,
            added,
            changed = change.changed.len(),
            moved = change.moved.len(),
            removed = change.removed.len(),
            motion = change::describe(change.stated_change.as_ref()),
            "replaced a map"
        );
        change::publish(&server.session, change).await
    }
}
