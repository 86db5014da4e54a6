//! Follows the releases of a map and the other servers that serve it, and has the cells that this server is to have.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use protocol::{MapChangeNotice, Validate as _, keys};
use releases::{CellId, Release, ReleaseSource, ReleaseStore, fetch_coarse};
use tokio::sync::oneshot;
use tokio::task::JoinHandle;
use tokio::time::MissedTickBehavior;

use super::assignment::cells_of;
use super::cell_map::CellMap;
use super::cold_file::ColdFolder;
use super::memory::CellMemory;
use super::stored_cell::{CellOrigin, StoredCell};
use super::tokens::Tokens;
use crate::change;
use crate::error::ServeError;
use crate::routing::CellDirectory;
use crate::server::MapServer;
use crate::state::{MapVersion, ServerState, note_served};

/// How long the set of servers stays as it is before cells are assigned: several that start together would else fetch all.
const SETTLING: Duration = Duration::from_secs(1);
/// How long a server waits at its start for the names of the others.
const FIRST_TOKENS: Duration = Duration::from_secs(2);
/// Beyond twice the interval of looking for releases, servers wait so long for each other before they change over.
const LOADING: Duration = Duration::from_secs(30);
/// Below the cache of a map: its cells that are not in memory.
const COLD: &str = "cold";

/// Which cells a server is to have.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CellChoice {
    /// Its share, as the servers of the map come and go.
    Auto,
    /// These.
    These(BTreeSet<CellId>),
}

/// Why a text is no choice of cells.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{given:?} names no cells: write auto, or numbers and ranges like 0-3,7")]
pub struct CellChoiceError {
    given: String,
}

/// More cells than these are a slip of the keyboard.
const MAX_RANGE: u32 = 1 << 20;

impl FromStr for CellChoice {
    type Err = CellChoiceError;

    fn from_str(text: &str) -> Result<CellChoice, CellChoiceError> {
        if text == "auto" {
            return Ok(CellChoice::Auto);
        }
        let refused = || CellChoiceError { given: text.to_owned() };
        let mut cells = BTreeSet::new();
        for part in text.split(',') {
            let (first, last) = part.split_once('-').unwrap_or((part, part));
            let [first, last] =
                [first, last].map(|number| number.trim().parse::<CellId>().map_err(|_| refused()));
            let (first, last) = (first?, last?);
            if first > last || last - first > MAX_RANGE {
                return Err(refused());
            }
            cells.extend(first..=last);
        }
        Ok(CellChoice::These(cells))
    }
}

/// How the cells of a map are served.
///
/// ```
/// let mut options = map_server::CellServiceOptions::new("maps/city-cache".into());
/// options.replicas = 3;
/// ```
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct CellServiceOptions {
    /// Folder for what is fetched.
    pub cache: PathBuf,
    /// Which cells this server has.
    pub choice: CellChoice,
    /// At how many servers each cell is, with [`CellChoice::Auto`].
    pub replicas: usize,
    /// Time between two looks for a new release.
    pub watch: Duration,
}

impl CellServiceOptions {
    /// Its share of the cells, each at two servers, and a look for a new release every 30 s.
    pub fn new(cache: PathBuf) -> Self {
        Self { cache, choice: CellChoice::Auto, replicas: 2, watch: Duration::from_secs(30) }
    }
}

/// The cells of one map, served by a [`MapServer`].
pub struct CellService {
    stop: oneshot::Sender<()>,
    running: JoinHandle<()>,
}

impl CellService {
    /// Serves the newest release of a map by cells, and follows new ones. When this returns, queries about the map are answered as
    /// far as its cells are at any server; this server's own are being fetched.
    ///
    /// # Errors
    /// [`ServeError::Release`] where no release can be read, from the store or from the cache; [`ServeError::Name`],
    /// [`ServeError::DuplicateMap`], [`ServeError::Zenoh`].
    pub async fn start(
        server: &MapServer,
        name: &str,
        store: ReleaseStore,
        options: CellServiceOptions,
    ) -> Result<CellService, ServeError> {
        keys::validate_name(name)?;
        let source = ReleaseSource::open(store, &options.cache)?;
        let release = Arc::new(source.newest_or_cached().await?);
        let directory = directory_of(&source, &release).await?;
        server.reserve(name)?;
        let host = server.host();
        let memory = Arc::clone(&host.memory);
        let cold = memory.bound().map(|_| cold_folder(&options.cache)).transpose()?;
        let session = host.session.clone();
        let members = Tokens::follow(&session, keys::map_member(name, None)?).await?;
        let holders = Tokens::follow(&session, keys::cell_holder(name, None, None)?).await?;
        let (me, is_drawn) = (host.server.clone(), host.drawings.is_some());
        let state = host.state.clone();
        let map = CellMap::start(host, name, directory).await?;
        tracing::info!(
            name,
            release = release.number,
            version = release.map.version,
            cells = release.cells.len(),
            keyframes = release.keyframes(),
            "serving a map by cells"
        );
        let service = Running {
            name: name.to_owned(),
            me,
            source,
            options,
            release,
            map,
            memory,
            cold,
            is_drawn,
            state,
            members,
            holders,
            session,
        };
        let (stop, stopped) = oneshot::channel();
        let running = tokio::spawn(async move {
            tokio::select! {
                _ = stopped => {}
                () = service.run() => {}
            }
        });
        Ok(CellService { stop, running })
    }

    /// Serves the map no more.
    pub async fn stop(self) {
        drop(self.stop);
        if let Err(error) = self.running.await {
            tracing::warn!("serving a map by cells ended badly: {error}");
        }
    }
}

/// What every server needs of a release.
async fn directory_of(source: &ReleaseSource, release: &Release) -> Result<Arc<CellDirectory>, ServeError> {
    let coarse = fetch_coarse(&source.store, release, Some(&source.cache)).await?;
    let release = release.clone();
    let indexing = tokio::task::spawn_blocking(move || CellDirectory::new(&release, coarse));
    Ok(Arc::new(indexing.await.map_err(|error| ServeError::task(&error))??))
}

/// The folder of cells that are not in memory.
fn cold_folder(cache: &Path) -> Result<Arc<ColdFolder>, ServeError> {
    let path = cache.join(COLD);
    ColdFolder::open(&path).map_err(|source| ServeError::ColdFolder { path, source })
}

struct Running {
    name: String,
    /// Name of this server.
    me: String,
    source: ReleaseSource,
    options: CellServiceOptions,
    release: Arc<Release>,
    map: CellMap,
    memory: Arc<CellMemory>,
    /// With a bound on the memory.
    cold: Option<Arc<ColdFolder>>,
    /// Whether the live map draws the cells.
    is_drawn: bool,
    state: Option<Arc<ServerState>>,
    members: Tokens,
    holders: Tokens,
    session: zenoh::Session,
}

impl Running {
    async fn run(mut self) {
        let is_noted = self.source.note(&self.release).await;
        self.note_served(&self.release).await;
        if is_noted {
            self.source.clean(&self.release);
        }
        let mut watch = tokio::time::interval(self.options.watch);
        watch.set_missed_tick_behavior(MissedTickBehavior::Delay);
        watch.reset();
        if self.options.choice == CellChoice::Auto {
            tokio::time::sleep(FIRST_TOKENS).await;
        }
        loop {
            let is_settled = self.have_cells().await;
            tokio::select! {
                () = self.members.changed() => self.wait_until_settled().await,
                () = self.holders.changed(), if !is_settled => {}
                _ = watch.tick() => self.follow_release().await,
            }
        }
    }

    /// Notes in the state of the server which release is served from now on.
    async fn note_served(&self, release: &Release) {
        let served = MapVersion {
            identity: release.identity(),
            version: release.map.version,
            digest: Some(release.digest),
        };
        note_served(self.state.as_ref(), &self.name, served).await;
    }

    /// Waits until no server has come or gone for a while.
    async fn wait_until_settled(&mut self) {
        while tokio::time::timeout(SETTLING, self.members.changed()).await.is_ok() {}
    }

    fn wanted(&self, release: &Release) -> BTreeSet<CellId> {
        let all = release.cells.iter().map(|cell| cell.cell);
        match &self.options.choice {
            CellChoice::These(cells) => all.filter(|cell| cells.contains(cell)).collect(),
            CellChoice::Auto => {
                let mut servers = self.members.names();
                servers.insert(self.me.clone());
                cells_of(&self.me, all, &servers, self.options.replicas)
            }
        }
    }

    /// Fetches the cells that this server lacks, and withdraws those that others have now in its place.
    ///
    /// # Returns
    /// Whether it has exactly what it is to have.
    async fn have_cells(&mut self) -> bool {
        let wanted = self.wanted(&self.release);
        let held = self.map.cells();
        for cell in wanted.difference(&held) {
            match StoredCell::prepare(self.origin(&self.release, *cell), &self.memory).await {
                Ok(stored) => {
                    let (bytes, in_memory) = (stored.bytes(), stored.is_in_memory());
                    if let Err(error) = self.map.add([(*cell, stored)]).await {
                        tracing::error!(name = self.name, cell, "a cell cannot be served: {error}");
                        continue;
                    }
                    tracing::info!(name = self.name, cell, bytes, in_memory, "serving a cell");
                }
                Err(error) => {
                    let reason = format!("{:#}", anyhow::Error::from(error));
                    tracing::warn!(
                        name = self.name,
                        cell,
                        reason,
                        "a cell cannot be fetched; trying again later"
                    );
                }
            }
        }
        let servers = self.members.names().len().max(1);
        let enough = self.options.replicas.clamp(1, servers);
        let mut is_settled = wanted.is_subset(&self.map.cells());
        for cell in held.difference(&wanted) {
            if self.others_with(*cell) >= enough {
                self.map.remove(*cell);
                tracing::info!(name = self.name, cell, "other servers have this cell now");
            } else {
                is_settled = false;
            }
        }
        is_settled
    }

    fn origin(&self, release: &Arc<Release>, cell: CellId) -> CellOrigin {
        CellOrigin {
            name: self.name.clone(),
            source: self.source.clone(),
            release: Arc::clone(release),
            cell,
            folder: self.cold.clone(),
            is_drawn: self.is_drawn,
        }
    }

    /// How many other servers have a cell.
    fn others_with(&self, cell: CellId) -> usize {
        let (infix, own) = (format!("/cell/{cell}/server/"), format!("/{}", self.me));
        self.holders.count(|key| key.contains(&infix) && !key.ends_with(&own))
    }

    /// Looks for a newer release, and changes over to it together with the other servers.
    async fn follow_release(&mut self) {
        // A task of its own: if it panics, the cells are served as before.
        let source = self.source.clone();
        let looking = tokio::spawn(async move { source.newest().await });
        let looked = looking.await.map_err(|error| ServeError::task(&error));
        let newest = match looked.and_then(|newest| Ok(newest?)) {
            Ok(Some(newest)) if newest.number > self.release.number => newest,
            Ok(_) => return,
            Err(error) => {
                let reason = format!("{:#}", anyhow::Error::from(error));
                tracing::warn!(name = self.name, reason, "no release can be read; the present one is served");
                return;
            }
        };
        if let Err(error) = self.change_to(newest).await {
            let reason = format!("{:#}", anyhow::Error::from(error));
            tracing::warn!(
                name = self.name,
                version = self.release.map.version,
                reason,
                "the new release cannot be served; the present one is"
            );
        }
    }

    async fn change_to(&mut self, release: Release) -> Result<(), ServeError> {
        if release.identity() != self.release.identity() {
            return Err(ServeError::OtherMap {
                name: self.name.clone(),
                served: self.release.identity(),
                given: release.identity(),
            });
        }
        let release = Arc::new(release);
        let served = self.map.directory().version();
        let change = self.source.store.change_since(served, &release).await?;
        let directory = directory_of(&self.source, &release).await?;
        let mut cells = BTreeMap::new();
        for cell in self.wanted(&release) {
            cells.insert(cell, StoredCell::prepare(self.origin(&release, cell), &self.memory).await?);
        }
        // The disk may be slow: before the servers change over together.
        let is_noted = self.source.note(&release).await;
        let token = self.map.announce(release.map.version).await?;
        self.wait_for_others(release.map.version).await?;
        let change = change.unwrap_or_default();
        self.note_served(&release).await;
        let new_cells = self.map.change_over(directory, cells, token);
        tracing::info!(
            name = self.name,
            release = release.number,
            from_version = served,
            version = release.map.version,
            changed = change.changed.len(),
            moved = change.moved.len(),
            removed = change.removed.len(),
            "changed over to a release"
        );
        let notice = MapChangeNotice {
            map: self.name.clone(),
            identity: release.identity(),
            from_version: served,
            version: release.map.version,
            changed: change.changed,
            moved: change.moved,
            removed: change.removed,
            stated_change: change.stated_change.filter(|size| size.validate().is_ok()),
            keyframe_motions: change.keyframe_motions,
        };
        self.release = release;
        // The new version answers already: what waits for the network comes after the notice.
        let published = change::publish(&self.session, notice).await;
        let added = self.map.add(new_cells).await;
        if is_noted {
            self.source.clean(&self.release);
        }
        if let Err(error) = published.and(added) {
            let reason = format!("{:#}", anyhow::Error::from(error));
            tracing::warn!(
                name = self.name,
                version = self.release.map.version,
                reason,
                "the new release is served, but robots or other servers were not told all of it"
            );
        }
        Ok(())
    }

    /// Waits until every server of the map has loaded a version, or has had the time for it.
    async fn wait_for_others(&mut self, version: u64) -> Result<(), ServeError> {
        let mut loaded =
            Tokens::follow(&self.session, keys::version_holder(&self.name, version, None)?).await?;
        let deadline = Instant::now() + 2 * self.options.watch + LOADING;
        loop {
            let missing: Vec<String> = self
                .members
                .names()
                .difference(&loaded.names())
                .filter(|name| **name != self.me)
                .cloned()
                .collect();
            if missing.is_empty() {
                return Ok(());
            }
            let changed = async {
                tokio::select! {
                    () = loaded.changed() => {}
                    () = self.members.changed() => {}
                }
            };
            if tokio::time::timeout_at(deadline.into(), changed).await.is_err() {
                tracing::warn!(
                    name = self.name,
                    version,
                    ?missing,
                    "changing over without these servers, which have not loaded the version: their cells answer when they have"
                );
                return Ok(());
            }
        }
    }
}
