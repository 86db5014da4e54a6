//! How much memory the cells of a server may take, and which of them have it.
//!
//! Cells beyond the bound are cold: on disk only, and loaded when they are asked for. For each that comes, those that were not asked
//! for longest go. One that a query is being answered with stays until the query has its answer.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use recognition::LoadedMap;
use tokio::sync::Semaphore;

use super::stored_cell::StoredCell;
use crate::metrics::ServerMetrics;

/// So many cold cells are loaded at once: more would only make each wait longer for the disk.
const LOADS_AT_ONCE: usize = 2;

/// The memory of the cells of a server, of all its maps.
pub(crate) struct CellMemory {
    /// Bytes; `None` without a bound.
    bound: Option<usize>,
    inner: Mutex<Inner>,
    /// Counts the queries, so that each cell knows when it was asked for last.
    clock: AtomicU64,
    /// Who reads a cell from the disk.
    pub(super) loads: Semaphore,
    /// Who makes a cell of its segments anew.
    pub(super) rebuilds: Semaphore,
    pub(super) metrics: Arc<ServerMetrics>,
}

#[derive(Default)]
struct Inner {
    cells: Vec<Weak<StoredCell>>,
    /// For cells that are being loaded.
    reserved: usize,
}

/// Cells that were dropped; their memory is free when this is.
#[must_use = "dropping a cell takes milliseconds: not while a lock is held"]
pub(super) struct Dropped(#[expect(dead_code, reason = "held until it is dropped")] Vec<Arc<LoadedMap>>);

/// Memory for a cell that is being loaded. Dropped once the cell is in memory: for a moment the cell counts twice, so that it always counts.
pub(super) struct Reserved<'a> {
    memory: &'a CellMemory,
    bytes: usize,
}

impl CellMemory {
    pub(crate) fn new(bound: Option<usize>, metrics: Arc<ServerMetrics>) -> Arc<CellMemory> {
        Arc::new(CellMemory {
            bound,
            inner: Mutex::default(),
            clock: AtomicU64::new(0),
            loads: Semaphore::new(LOADS_AT_ONCE),
            rebuilds: Semaphore::new(1),
            metrics,
        })
    }

    /// Bytes that loaded cells may take.
    pub(crate) fn bound(&self) -> Option<usize> {
        self.bound
    }

    /// The time by this clock, which each call advances.
    pub(super) fn tick(&self) -> u64 {
        self.clock.fetch_add(1, Ordering::Relaxed)
    }

    /// Takes a new cell, into memory where there is room or where it is nowhere else.
    pub(super) fn adopt(&self, cell: &Arc<StoredCell>, map: Arc<LoadedMap>) {
        let mut inner = self.lock();
        inner.cells.retain(|cell| cell.strong_count() > 0);
        let is_kept = self.has_room(&inner, cell.bytes()) || !cell.is_on_disk();
        inner.cells.push(Arc::downgrade(cell));
        if is_kept {
            cell.put(map);
        }
        self.note(&inner);
    }

    /// Makes room for a cell that will be loaded.
    pub(super) fn reserve(&self, bytes: usize) -> (Reserved<'_>, Dropped) {
        let mut inner = self.lock();
        let dropped = self.make_room(&inner, bytes);
        inner.reserved += bytes;
        self.note(&inner);
        (Reserved { memory: self, bytes }, dropped)
    }

    /// Drops what exceeds the bound: queries may have held it.
    pub(crate) fn trim(&self) {
        if self.bound.is_some() {
            let inner = self.lock();
            let dropped = self.make_room(&inner, 0);
            self.note(&inner);
            drop(inner);
            drop(dropped);
        }
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn has_room(&self, inner: &Inner, bytes: usize) -> bool {
        let used = inner.alive().filter(|cell| cell.is_in_memory()).map(|cell| cell.bytes()).sum::<usize>();
        self.bound.is_none_or(|bound| used.saturating_add(inner.reserved).saturating_add(bytes) <= bound)
    }

    fn make_room(&self, inner: &Inner, bytes: usize) -> Dropped {
        let mut dropped = Vec::new();
        if self.has_room(inner, bytes) {
            return Dropped(dropped);
        }
        let mut oldest: Vec<Arc<StoredCell>> = inner.alive().collect();
        oldest.sort_by_key(|cell| cell.asked());
        for cell in oldest {
            dropped.extend(cell.take_unused());
            if self.has_room(inner, bytes) {
                break;
            }
        }
        Dropped(dropped)
    }

    fn note(&self, inner: &Inner) {
        let (mut cells, mut loaded, mut bytes) = (0, 0, 0);
        for cell in inner.alive() {
            cells += 1;
            if cell.is_in_memory() {
                (loaded, bytes) = (loaded + 1, bytes + cell.bytes());
            }
        }
        self.metrics.note_cells(cells, loaded, bytes);
    }

    /// Counts anew after cells were given up.
    pub(super) fn note_gone(&self) {
        self.note(&self.lock());
    }
}

impl Inner {
    fn alive(&self) -> impl Iterator<Item = Arc<StoredCell>> {
        self.cells.iter().filter_map(Weak::upgrade)
    }
}

impl Drop for Reserved<'_> {
    fn drop(&mut self) {
        let mut inner = self.memory.lock();
        inner.reserved -= self.bytes;
        self.memory.note(&inner);
    }
}
