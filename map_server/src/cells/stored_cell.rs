//! A cell of a release at a server: in memory, or on disk until it is asked for.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock};
use std::time::{Duration, Instant};

use protocol::{ErrorCode, ErrorReply};
use recognition::LoadedMap;
use releases::{Cell, CellId, Release, ReleaseSource, fetch_cell};
use tokio::sync::watch;
use viewer::ViewedPart;

use super::cold_file::{ColdFile, ColdFolder};
use super::drawings::part_of;
use super::memory::CellMemory;
use crate::error::ServeError;

/// Where a cell comes from.
pub(crate) struct CellOrigin {
    /// Of the map, for messages.
    pub(crate) name: String,
    pub(crate) source: ReleaseSource,
    pub(crate) release: Arc<Release>,
    pub(crate) cell: CellId,
    /// Where it is kept while it is not in memory; `None`: it always is.
    pub(crate) folder: Option<Arc<ColdFolder>>,
    /// Whether the live map draws it.
    pub(crate) is_drawn: bool,
}

/// A cell as its segments give it.
struct LoadedCell {
    map: Arc<LoadedMap>,
    drawing: Option<Arc<ViewedPart>>,
}

impl CellOrigin {
    /// Makes the cell of its segments: of the cache, or of the store.
    async fn load(&self) -> Result<LoadedCell, ServeError> {
        let fetched =
            fetch_cell(&self.source.store, &self.release, self.cell, Some(&self.source.cache)).await?;
        let Cell { own, contents, far_cross_covariances, aliases } = fetched;
        let drawn = self.is_drawn.then(|| Arc::clone(&self.release));
        let indexing = tokio::task::spawn_blocking(move || {
            let drawing = drawn.map(|release| Arc::new(part_of(&release, &contents, &own, &aliases)));
            LoadedMap::from_part(contents, far_cross_covariances, &aliases)
                .inspect(|map| _ = map.aliasing_rate())
                .map(|map| LoadedCell { map: Arc::new(map), drawing })
        });
        Ok(indexing.await.map_err(|error| ServeError::task(&error))??)
    }

    /// Keeps the cell on disk; `None` where that is not wanted, or not possible and said.
    async fn freeze(&self, map: &Arc<LoadedMap>) -> Option<Arc<ColdFile>> {
        let (folder, map) = (Arc::clone(self.folder.as_ref()?), Arc::clone(map));
        let writing = tokio::task::spawn_blocking(move || ColdFile::write(&folder, &map));
        let reason = match writing.await {
            Ok(Ok(file)) => return Some(Arc::new(file)),
            Ok(Err(error)) => error.to_string(),
            Err(error) => error.to_string(),
        };
        tracing::warn!(
            name = self.name,
            cell = self.cell,
            reason,
            "a cell cannot be kept on disk and stays in memory, whatever --memory says: is the disk of --cache full?"
        );
        None
    }
}

/// What a query gets that waited for a cell: the cell, or why it did not come.
type Brought = Result<Arc<LoadedMap>, String>;

enum State {
    Cold,
    /// Being loaded, once for all who wait.
    Coming(watch::Receiver<Option<Brought>>),
    InMemory(Arc<LoadedMap>),
}

/// One version of a cell.
pub(crate) struct StoredCell {
    origin: CellOrigin,
    /// In memory.
    bytes: usize,
    drawing: Option<Arc<ViewedPart>>,
    file: Mutex<Option<Arc<ColdFile>>>,
    state: Mutex<State>,
    /// When it was asked for last, by the memory's clock.
    asked: AtomicU64,
    memory: Arc<CellMemory>,
}

impl StoredCell {
    /// Fetches and indexes a cell. It stays in memory where there is room.
    pub(crate) async fn prepare(
        origin: CellOrigin,
        memory: &Arc<CellMemory>,
    ) -> Result<Arc<StoredCell>, ServeError> {
        let LoadedCell { map, drawing } = origin.load().await?;
        let file = origin.freeze(&map).await;
        let cell = Arc::new(StoredCell {
            origin,
            bytes: map.bytes_in_memory(),
            drawing,
            file: Mutex::new(file),
            state: Mutex::new(State::Cold),
            asked: AtomicU64::new(0),
            memory: Arc::clone(memory),
        });
        memory.adopt(&cell, map);
        Ok(cell)
    }

    /// The cell where it is in memory.
    pub(crate) fn if_in_memory(&self) -> Option<Arc<LoadedMap>> {
        self.asked.store(self.memory.tick(), Ordering::Relaxed);
        match &*self.state() {
            State::InMemory(map) => Some(Arc::clone(map)),
            State::Cold | State::Coming(_) => None,
        }
    }

    /// The cell, from the disk where it is not in memory.
    ///
    /// # Errors
    /// [`ErrorCode::Busy`] where it does not come in time: ask again.
    pub(crate) async fn bring(self: &Arc<Self>, within: Duration) -> Result<Arc<LoadedMap>, ErrorReply> {
        let CellOrigin { name, cell, .. } = &self.origin;
        let busy =
            |reason: &str| ErrorReply::new(ErrorCode::Busy, format!("cell {cell} of map {name} {reason}"));
        let mut coming = match self.ask() {
            Ok(map) => return Ok(map),
            Err(coming) => coming,
        };
        let brought = tokio::time::timeout(within, coming.wait_for(Option::is_some)).await;
        match brought.map(|brought| brought.ok().and_then(|brought| brought.clone())) {
            Ok(Some(Ok(map))) => Ok(map),
            Ok(Some(Err(reason))) => Err(busy(&format!("cannot be loaded: {reason}"))),
            Ok(None) => Err(busy("cannot be loaded")),
            Err(_) => Err(busy("is being loaded from the disk, ask again")),
        }
    }

    /// Begins to load the cell where nobody does; those that were in memory before a change of the map come back like this.
    pub(crate) fn warm_up(self: &Arc<Self>, like: &StoredCell) {
        self.asked.store(like.asked(), Ordering::Relaxed);
        if like.is_in_memory() {
            drop(self.ask());
        }
    }

    /// The cell, or where it will come; who asks first has it loaded.
    fn ask(self: &Arc<Self>) -> Result<Arc<LoadedMap>, watch::Receiver<Option<Brought>>> {
        let mut state = self.state();
        match &*state {
            State::InMemory(map) => Ok(Arc::clone(map)),
            State::Coming(coming) => Err(coming.clone()),
            State::Cold => {
                let (tell, coming) = watch::channel(None);
                *state = State::Coming(coming.clone());
                tokio::spawn(Arc::clone(self).load(tell));
                Err(coming)
            }
        }
    }

    async fn load(self: Arc<Self>, tell: watch::Sender<Option<Brought>>) {
        let begin = Instant::now();
        let mut until_loaded = UntilLoaded { cell: &self, is_loaded: false };
        let brought = self.read_or_rebuild().await;
        until_loaded.is_loaded = brought.is_ok();
        drop(until_loaded);
        if brought.is_ok() {
            self.memory.metrics.note_cold_load(begin.elapsed());
        }
        let brought = brought.map_err(|error| {
            let CellOrigin { name, cell, .. } = &self.origin;
            let reason = format!("{:#}", anyhow::Error::from(error));
            tracing::error!(
                name,
                cell,
                reason,
                "a cell cannot be loaded; queries about it are answered as busy"
            );
            reason
        });
        tell.send_replace(Some(brought));
    }

    /// Reads the cell from the disk, or where that fails makes it of its segments.
    async fn read_or_rebuild(self: &Arc<Self>) -> Result<Arc<LoadedMap>, ServeError> {
        let memory = &self.memory;
        let closed = |_| ServeError::TaskFailed { problem: "the memory of cells is closed".to_owned() };
        let place = memory.loads.acquire().await.map_err(closed)?;
        let (_reserved, dropped) = memory.reserve(self.bytes);
        let file = self.file().clone();
        let reading = tokio::task::spawn_blocking(move || {
            drop(dropped);
            file.map(|file| file.read())
        });
        let reason = match reading.await {
            Ok(Some(Ok(map))) => {
                let map = Arc::new(map);
                self.put(Arc::clone(&map));
                return Ok(map);
            }
            Ok(Some(Err(error))) => error.to_string(),
            Ok(None) => "it is not kept there".to_owned(),
            // A panic: what it was about must not be read again and again.
            Err(error) => ServeError::task(&error).to_string(),
        };
        drop(place);
        let CellOrigin { name, cell, .. } = &self.origin;
        tracing::warn!(
            name,
            cell,
            reason,
            "a cell cannot be read from the disk and is made of its segments anew"
        );
        let _one_at_a_time = memory.rebuilds.acquire().await.map_err(closed)?;
        let LoadedCell { map, .. } = self.origin.load().await?;
        *self.file() = self.origin.freeze(&map).await;
        self.put(Arc::clone(&map));
        Ok(map)
    }

    /// Bytes that the cell takes in memory.
    pub(crate) fn bytes(&self) -> usize {
        self.bytes
    }

    /// What the live map draws of it.
    pub(crate) fn drawing(&self) -> Option<Arc<ViewedPart>> {
        self.drawing.clone()
    }

    pub(crate) fn memory(&self) -> &CellMemory {
        &self.memory
    }

    pub(super) fn asked(&self) -> u64 {
        self.asked.load(Ordering::Relaxed)
    }

    pub(crate) fn is_in_memory(&self) -> bool {
        matches!(*self.state(), State::InMemory(_))
    }

    pub(super) fn is_on_disk(&self) -> bool {
        self.file().is_some()
    }

    pub(super) fn put(&self, map: Arc<LoadedMap>) {
        *self.state() = State::InMemory(map);
    }

    /// Takes the cell out of memory, if no query is being answered with it and it is on disk.
    pub(super) fn take_unused(&self) -> Option<Arc<LoadedMap>> {
        if !self.is_on_disk() {
            return None;
        }
        let mut state = self.state();
        match std::mem::replace(&mut *state, State::Cold) {
            State::InMemory(map) if Arc::strong_count(&map) == 1 => Some(map),
            other => {
                *state = other;
                None
            }
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn file(&self) -> MutexGuard<'_, Option<Arc<ColdFile>>> {
        self.file.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Lets whoever asks next try again where loading a cell ends without the cell, be it by a panic.
struct UntilLoaded<'a> {
    cell: &'a StoredCell,
    is_loaded: bool,
}

impl Drop for UntilLoaded<'_> {
    fn drop(&mut self) {
        if self.is_loaded {
            return;
        }
        *self.cell.state() = State::Cold;
        self.cell.memory.metrics.note_failed_cold_load();
        if std::thread::panicking() {
            let CellOrigin { name, cell, .. } = &self.cell.origin;
            tracing::error!(
                name,
                cell,
                "loading a cell panicked; whoever asks for it next has it loaded again"
            );
        }
    }
}

/// A cell that is served, which can be replaced by another version of it.
pub(crate) struct CellSlot {
    /// Of the map.
    pub(crate) name: String,
    pub(crate) cell: CellId,
    stored: RwLock<Arc<StoredCell>>,
}

impl CellSlot {
    pub(crate) fn new(name: &str, cell: CellId, stored: Arc<StoredCell>) -> CellSlot {
        CellSlot { name: name.to_owned(), cell, stored: RwLock::new(stored) }
    }

    pub(crate) fn current(&self) -> Arc<StoredCell> {
        Arc::clone(&self.stored.read().unwrap_or_else(PoisonError::into_inner))
    }

    /// Exchanges the version and returns the previous one.
    pub(crate) fn replace(&self, stored: Arc<StoredCell>) -> Arc<StoredCell> {
        std::mem::replace(&mut *self.stored.write().unwrap_or_else(PoisonError::into_inner), stored)
    }
}
