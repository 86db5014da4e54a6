//! What is shown, and the HTTP server that shows it.

use crate::api;
use crate::changes::ViewedChanges;
use crate::error::ViewerError;
use crate::images::LocalizeImage;
use crate::keyframe_images::KeyframeImages;
use crate::live::Live;
use crate::outbox::Outbox;
use crate::queries::ViewedQuery;
use crate::run::RunTracks;
use crate::statistics::ServerSample;
use crate::viewed_map::ViewedMap;
use axum::Router;
use axum::body::Bytes;
use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::{Arc, OnceLock, PoisonError, RwLock};
use tokio::net::TcpListener;
use tokio::sync::Semaphore;
use tokio::task::JoinHandle;

/// What is shown: maps, robots, a run.
pub struct Viewer {
    maps: RwLock<BTreeMap<String, Arc<ViewedMap>>>,
    keyframe_images: RwLock<BTreeMap<String, Arc<dyn KeyframeImages>>>,
    /// How maps differ from other releases, as JSON.
    changes: RwLock<BTreeMap<String, Bytes>>,
    /// The recorded run as JSON.
    run: RwLock<Option<Bytes>>,
    /// Whether robots may come.
    is_live: bool,
    images: OnceLock<Arc<dyn LocalizeImage>>,
    /// Images are localized one at a time.
    pub(crate) image_turn: Arc<Semaphore>,
    /// Images of keyframes are read one at a time.
    pub(crate) disk_turn: Arc<Semaphore>,
    pub(crate) outbox: Outbox,
    pub(crate) live: Live,
}

impl Viewer {
    /// Nothing yet.
    pub fn new() -> Arc<Self> {
        Arc::new(Self::empty(true))
    }

    /// A recorded run, if there is one: the page then does not wait for robots.
    pub fn with_run(run: Option<RunTracks>) -> Arc<Self> {
        let viewer = Self::empty(run.is_none());
        if let Some(run) = run {
            viewer.set_run(&run);
        }
        Arc::new(viewer)
    }

    /// Stored maps: no robots come.
    pub fn of_stored_maps() -> Arc<Self> {
        Arc::new(Self::empty(false))
    }

    fn empty(is_live: bool) -> Self {
        Self {
            maps: RwLock::default(),
            keyframe_images: RwLock::default(),
            changes: RwLock::default(),
            run: RwLock::default(),
            is_live,
            images: OnceLock::new(),
            image_turn: Arc::new(Semaphore::new(1)),
            disk_turn: Arc::new(Semaphore::new(1)),
            outbox: Outbox::default(),
            live: Live::default(),
        }
    }

    /// Shows a recorded run, in place of the one before; open pages offer it.
    pub fn set_run(&self, run: &RunTracks) {
        // Its values are finite, so that it can always be written.
        let answer = serde_json::to_vec(run).unwrap_or_default();
        *self.run.write().unwrap_or_else(PoisonError::into_inner) = Some(answer.into());
        self.live.note_run(&run.name);
    }

    /// Lets people localize images in the maps. Once given, it stays.
    pub fn take_images(&self, images: Arc<dyn LocalizeImage>) {
        // The first one stays.
        let _ = self.images.set(images);
    }

    /// Shows a map, in place of the one of the same name; open pages load it again.
    pub fn set_map(&self, mut map: ViewedMap) {
        let (name, version) = (map.name().to_owned(), map.version());
        let mut maps = self.maps.write().unwrap_or_else(PoisonError::into_inner);
        let revision = maps.get(&name).map_or(1, |former| former.summary.revision + 1);
        map.summary.revision = revision;
        maps.insert(name.clone(), Arc::new(map));
        drop(maps);
        self.live.note_map(&name, version, revision);
    }

    /// Shows the images of a map's keyframes, in place of those before.
    pub fn set_keyframe_images(&self, name: &str, images: Arc<dyn KeyframeImages>) {
        self.keyframe_images.write().unwrap_or_else(PoisonError::into_inner).insert(name.to_owned(), images);
    }

    /// The images of a map's keyframes, where there are some.
    pub(crate) fn keyframe_images(&self, name: &str) -> Option<Arc<dyn KeyframeImages>> {
        let all = self.keyframe_images.read().unwrap_or_else(PoisonError::into_inner);
        all.get(name).filter(|images| images.count() > 0).cloned()
    }

    /// Shows how a map differs from its last release and from a candidate, in place of what was shown before; open pages load it.
    pub fn set_changes(&self, name: &str, changes: &ViewedChanges) {
        let answer = changes.answer(name);
        self.changes.write().unwrap_or_else(PoisonError::into_inner).insert(name.to_owned(), answer);
        self.live.note_changes(name);
    }

    /// The answer about how a map differs from other releases; `None` for an unknown map.
    pub(crate) fn changes(&self, name: &str) -> Option<Bytes> {
        let known = self.changes.read().unwrap_or_else(PoisonError::into_inner).get(name).cloned();
        known.or_else(|| {
            let version = self.version(name)?;
            Some(ViewedChanges { version, ..ViewedChanges::default() }.answer(name))
        })
    }

    /// The version of a map that is shown.
    pub fn version(&self, name: &str) -> Option<u64> {
        self.map(name).map(|map| map.version())
    }

    /// Shows a query and what became of it; the last [`MAX_QUERIES`](crate::MAX_QUERIES) are kept.
    ///
    /// # Arguments
    /// * `client`: who asked, by the id of its Zenoh session; it may be a robot's or not.
    pub fn note_query(&self, client: &str, query: ViewedQuery) {
        let _ = self.live.note_query(client, query);
    }

    /// Shows what the map server did in the last [`STATISTICS_PERIOD`](crate::STATISTICS_PERIOD); an hour is kept.
    pub fn note_statistics(&self, sample: ServerSample) {
        self.live.note_statistics(sample);
    }

    pub(crate) fn maps(&self) -> Vec<Arc<ViewedMap>> {
        self.maps.read().unwrap_or_else(PoisonError::into_inner).values().cloned().collect()
    }

    pub(crate) fn map(&self, name: &str) -> Option<Arc<ViewedMap>> {
        self.maps.read().unwrap_or_else(PoisonError::into_inner).get(name).cloned()
    }

    pub(crate) fn run(&self) -> Option<Bytes> {
        self.run.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    pub(crate) fn is_live(&self) -> bool {
        self.is_live
    }

    pub(crate) fn images(&self) -> Option<Arc<dyn LocalizeImage>> {
        self.images.get().cloned()
    }
}

/// A running HTTP server.
pub struct ViewerServer {
    address: SocketAddr,
    serving: JoinHandle<()>,
    ticking: JoinHandle<()>,
}

impl ViewerServer {
    /// Starts to serve a viewer.
    ///
    /// # Arguments
    /// * `address`: port 0 takes any free one. It knows no users: other addresses than loopback are warned about.
    ///
    /// # Errors
    /// [`ViewerError::Bind`].
    pub async fn start(address: SocketAddr, viewer: Arc<Viewer>) -> Result<Self, ViewerError> {
        Self::start_with(address, viewer, Router::new()).await
    }

    /// The same, with other routes beside those of the viewer.
    ///
    /// # Errors
    /// [`ViewerError::Bind`].
    pub async fn start_with(
        address: SocketAddr,
        viewer: Arc<Viewer>,
        beside: Router,
    ) -> Result<Self, ViewerError> {
        let cannot_bind = |source| ViewerError::Bind { address, source };
        let listener = TcpListener::bind(address).await.map_err(cannot_bind)?;
        let address = listener.local_addr().map_err(cannot_bind)?;
        if !address.ip().is_loopback() {
            tracing::warn!(
                %address,
                "the map and all robots are shown to everybody who reaches this address; it knows no users"
            );
        }
        let ticking = tokio::spawn(Arc::clone(&viewer).tick_live());
        let router = api::router(viewer, beside);
        let serving = tokio::spawn(monitoring::serve(listener, router));
        tracing::info!("the map is shown on http://{address}");
        Ok(Self { address, serving, ticking })
    }

    /// The address that it listens on.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Stops at once.
    pub async fn stop(self) {
        for task in [self.serving, self.ticking] {
            task.abort();
            // Cancelled, as asked for.
            let _ = task.await;
        }
    }
}
