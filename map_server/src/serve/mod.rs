//! Maps on the network: Zenoh queryables around [`LoadedMap`]s.
//!
//! | key (below the session's namespace) | asks | answers |
//! |---|---|---|
//! | `map/{map}/match` | [`protocol::MatchRequest`] | [`protocol::MatchReply`]s, the last of them `Done` |
//! | `map/{map}/localize` | [`protocol::LocalizeRequest`] | [`protocol::LocalizeReply`] |
//! | `map/{map}/info` | nothing | [`protocol::MapInfo`] |
//! | `map/{map}/keyframes/{id}` | nothing | [`protocol::KeyframeReply`]; `*` for all, one a reply |
//! | `map/{map}/changes` | | publishes [`protocol::MapChange`] when a map is replaced |
//! | `map_server/{server}` | | liveliness, declared after all queryables |
//!
//! Replies are bincode, or JSON where the query says `?format=json` or brings JSON; errors come as
//! [`protocol::ErrorReply`] by Zenoh's error reply.
//!
//! # What a client must know
//! * A match answer has several replies on one key: ask with `ConsolidationMode::None`, or Zenoh keeps one of them.
//! * Zenoh 1.10 sends replies with the congestion control *of the query* (`Block` by default). Ask with `Block`, or
//!   large replies may be dropped.
//! * Nothing at all is a failure to retry, never "no match".
//!
//! # Maps that nobody here has
//! A map's own queryables are complete; beside them the server declares incomplete ones on `map/*/match`,
//! `map/*/localize`, `map/*/info` and `map/*/keyframes/*`. Zenoh's default target (`BestMatching`) asks a complete
//! queryable wherever on the network it is, and the incomplete ones only where there is none: another server's map
//! is never shadowed, and a map that no server has gets an [`protocol::ErrorCode::UnknownMap`] that lists what
//! there is. To a client that is connecting the right server may still be on its way: it asks again later.

mod change;
mod handlers;
mod queue;

use std::collections::BTreeMap;
use std::sync::{Arc, PoisonError, RwLock};
use std::time::Duration;

use protocol::{Format, StatedChange, keys};
use tokio::task::JoinHandle;
use zenoh::Session;
use zenoh::bytes::Encoding;
use zenoh::liveliness::LivelinessToken;
use zenoh::qos::CongestionControl;
use zenoh::query::{Query, Queryable};

use self::handlers::Kind;
use self::queue::{Job, Queue};
use recognition::{LoadedMap, RecognitionOptions};

pub use self::queue::ServerStatistics;

/// How long [`MapServer::stop`] waits for queries that are being answered.
const STOP_TIMEOUT: Duration = Duration::from_secs(5);

/// A map and the name under which it is served.
pub struct ServedMap {
    /// One chunk of a key: see [`protocol::keys::validate_name`].
    pub name: String,
    /// The map.
    pub map: Arc<LoadedMap>,
}

/// Settings of a server.
#[derive(Clone, Debug, PartialEq)]
pub struct ServerOptions {
    /// Name of the server in its liveliness key. `None`: the id of its Zenoh session.
    pub name: Option<String>,
    /// Settings of recognition for all maps.
    pub recognition: RecognitionOptions,
    /// Queries that are worked on at the same time.
    pub workers: usize,
    /// Queries that may wait; one more is answered with [`protocol::ErrorCode::Busy`].
    pub queue_length: usize,
    /// Bytes that the payloads of waiting queries may have together.
    pub queue_bytes: usize,
}

impl Default for ServerOptions {
    fn default() -> ServerOptions {
        ServerOptions {
            name: None,
            recognition: RecognitionOptions::default(),
            workers: std::thread::available_parallelism().map_or(2, std::num::NonZero::get),
            queue_length: 64,
            queue_bytes: 64 << 20,
        }
    }
}

/// Why a server does not start, or a map is not replaced.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// A name cannot be part of a key.
    #[error(transparent)]
    Name(#[from] keys::NameError),
    /// Two maps have one name.
    #[error("two maps are to be served as {0:?}: give each its own name")]
    TwoMapsOfOneName(String),
    /// The server has no map of that name.
    #[error("no map named {0:?} is served here")]
    UnknownMap(String),
    /// A message cannot be encoded.
    #[error(transparent)]
    Codec(#[from] protocol::CodecError),
    /// Zenoh refused.
    #[error("Zenoh: {0}")]
    Zenoh(zenoh::Error),
}

impl From<zenoh::Error> for ServeError {
    fn from(error: zenoh::Error) -> ServeError {
        ServeError::Zenoh(error)
    }
}

/// A map that can be exchanged while it is served; a query keeps the one that it began with.
pub(crate) struct Served {
    name: String,
    map: RwLock<Arc<LoadedMap>>,
}

impl Served {
    fn current(&self) -> Arc<LoadedMap> {
        Arc::clone(&self.map.read().unwrap_or_else(PoisonError::into_inner))
    }
}

/// A running map server.
///
/// It lives in the session that it was started with and leaves that open when it stops.
pub struct MapServer {
    session: Session,
    maps: Arc<BTreeMap<String, Arc<Served>>>,
    token: LivelinessToken,
    queryables: Vec<Queryable<()>>,
    queue: Arc<Queue>,
    workers: Vec<JoinHandle<()>>,
}

impl MapServer {
    /// Serves maps in an open session. When this returns, every queryable is declared, and then the liveliness token.
    ///
    /// Needs a multi-threaded tokio runtime.
    ///
    /// # Errors
    /// [`ServeError`]; nothing is left declared.
    pub async fn start(
        session: Session,
        maps: Vec<ServedMap>,
        options: ServerOptions,
    ) -> Result<MapServer, ServeError> {
        let server = options.name.clone().unwrap_or_else(|| session.zid().to_string());
        let token_key = keys::map_server(&server)?;
        let mut served = BTreeMap::new();
        for ServedMap { name, map } in maps {
            keys::validate_name(&name)?;
            let map = Served { name: name.clone(), map: RwLock::new(map) };
            if served.insert(name.clone(), Arc::new(map)).is_some() {
                return Err(ServeError::TwoMapsOfOneName(name));
            }
        }
        let maps = Arc::new(served);

        let (queue, jobs) = Queue::new(options.queue_length, options.queue_bytes);
        let workers = queue::start_workers(jobs, options.workers, &options.recognition, &queue);
        let mut queryables = Vec::new();
        for map in maps.values() {
            for kind in Kind::ALL {
                let key = kind.key(&map.name)?;
                let (queue, map) = (Arc::clone(&queue), Arc::clone(map));
                let callback = move |query: Query| queue.put(Job { query, kind, map: Arc::clone(&map) });
                queryables.push(session.declare_queryable(key).callback(callback).complete(true).await?);
            }
        }
        for kind in Kind::ALL {
            let known = Arc::clone(&maps);
            let callback = move |query: Query| handlers::refuse_unknown_map(&query, &known);
            queryables.push(session.declare_queryable(kind.key_of_any_map()).callback(callback).await?);
        }
        let token = session.liveliness().declare_token(token_key).await?;
        tracing::info!(server, maps = ?maps.keys().collect::<Vec<_>>(), "serving");
        Ok(MapServer { session, maps, token, queryables, queue, workers })
    }

    /// The version of a map that is served now; `None` for a map that is not served here.
    pub fn version(&self, name: &str) -> Option<u64> {
        self.maps.get(name).map(|served| served.current().info().version)
    }

    /// What the server has done so far.
    pub fn statistics(&self) -> ServerStatistics {
        self.queue.statistics()
    }

    /// Exchanges a map while it is served and publishes what changed on `map/{map}/changes`. Queries that are being
    /// answered end with the old one.
    ///
    /// # Arguments
    /// * `stated_change`: how far the map moved under the robots, by whoever changed it; else it is worked out from the
    ///   keyframes that both versions have.
    ///
    /// # Errors
    /// [`ServeError::UnknownMap`]; [`ServeError::Zenoh`] where the map was exchanged but not announced.
    pub async fn replace(
        &self,
        name: &str,
        map: Arc<LoadedMap>,
        stated_change: Option<StatedChange>,
    ) -> Result<(), ServeError> {
        let served = self.maps.get(name).ok_or_else(|| ServeError::UnknownMap(name.to_owned()))?;
        let new = Arc::clone(&map);
        let old = std::mem::replace(&mut *served.map.write().unwrap_or_else(PoisonError::into_inner), map);
        let mut change = change::between(name, &old, &new);
        change.stated_change = stated_change.or(change.stated_change);
        tracing::info!(
            name,
            from_version = change.from_version,
            version = change.version,
            keyframes = new.keyframe_count(),
            added = change::added(&old, &new),
            changed = change.changed.len(),
            moved = change.moved.len(),
            removed = change.removed.len(),
            moved_by = change::describe(change.stated_change.as_ref()),
            "replaced a map"
        );
        let payload = protocol::encode(Format::Bincode, &change)?;
        let publication = self.session.put(keys::map_changes(name)?, payload);
        publication
            .encoding(Encoding::from(Format::Bincode.encoding()))
            .congestion_control(CongestionControl::Block)
            .await?;
        Ok(())
    }

    /// Stops serving: leaves the network first, then answers what has been asked already (for 5 s at most).
    ///
    /// # Errors
    /// [`ServeError::Zenoh`] where something could not be undeclared, which happens when the session is closed.
    pub async fn stop(self) -> Result<(), ServeError> {
        let MapServer { token, queryables, queue, workers, .. } = self;
        let mut result = token.undeclare().await;
        for queryable in queryables {
            let undeclared = queryable.undeclare().await;
            result = result.and(undeclared);
        }
        queue.close();
        let all_done = async {
            for worker in workers {
                if let Err(error) = worker.await {
                    tracing::warn!("a worker of the map server ended badly: {error}");
                }
            }
        };
        if tokio::time::timeout(STOP_TIMEOUT, all_done).await.is_err() {
            tracing::warn!("some queries were still being answered after {STOP_TIMEOUT:?}, left them");
        }
        tracing::info!(statistics = ?queue.statistics(), "stopped serving");
        Ok(result?)
    }
}
