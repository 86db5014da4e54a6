//! What the live map draws of the cells that a server has.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use map::{KeyframeAliases, MapContents, MapMetadata};
use protocol::KeyframeId;
use releases::{CellId, Release};
use tokio::sync::watch;
use viewer::{DrawnShare, ViewedMap, ViewedPart};

/// The maps of a server that are served by cells, as they are drawn.
pub(crate) struct CellDrawings {
    maps: Mutex<BTreeMap<String, DrawnMap>>,
    /// Counts the changes.
    changes: watch::Sender<u64>,
}

/// The cells of a map that a server has.
#[derive(Clone)]
pub(crate) struct DrawnMap {
    pub(crate) info: MapMetadata,
    /// How many the map has at all servers.
    pub(crate) all_cells: usize,
    pub(crate) cells: BTreeMap<CellId, Arc<ViewedPart>>,
}

impl CellDrawings {
    pub(crate) fn new() -> Arc<Self> {
        Arc::new(Self { maps: Mutex::default(), changes: watch::Sender::new(0) })
    }

    /// Draws a map in place of what was drawn under its name.
    pub(crate) fn set(&self, name: &str, map: DrawnMap) {
        self.lock().insert(name.to_owned(), map);
        self.changes.send_modify(|count| *count += 1);
    }

    /// Follows the changes.
    pub(crate) fn changes(&self) -> watch::Receiver<u64> {
        self.changes.subscribe()
    }

    /// The maps as they are now.
    pub(crate) fn maps(&self) -> BTreeMap<String, DrawnMap> {
        self.lock().clone()
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<String, DrawnMap>> {
        self.maps.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl DrawnMap {
    /// Takes some tens of milliseconds for a large map.
    pub(crate) fn view(&self, name: &str) -> ViewedMap {
        ViewedMap::of_parts(name, &self.info, self.all_cells, self.cells.values().map(AsRef::as_ref))
    }

    /// Whether nothing would be drawn in another way.
    pub(crate) fn is_like(&self, other: &DrawnMap) -> bool {
        let cells = self.cells.iter().zip(&other.cells);
        self.info.version == other.info.version
            && (self.all_cells, self.cells.len()) == (other.all_cells, other.cells.len())
            && cells
                .into_iter()
                .all(|((id, one), (other_id, other))| id == other_id && Arc::ptr_eq(one, other))
    }
}

/// What of a cell is drawn.
///
/// # Arguments
/// * `contents`: of the cell with its border.
/// * `own`: the cell's keyframes.
/// * `aliases`: what they could be taken for.
pub(crate) fn part_of(
    release: &Release,
    contents: &MapContents,
    own: &[KeyframeId],
    aliases: &[KeyframeAliases],
) -> ViewedPart {
    ViewedPart::new(contents, own, aliases, DrawnShare::of(release.keyframes(), release.landmarks()))
}
