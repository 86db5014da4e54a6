//! Draws the cells of a server for the page, as they come and go.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::watch;
use viewer::Viewer;

use crate::cells::{CellDrawings, DrawnMap};

/// Time between two drawings: a server that starts gets one cell after the other.
const REST: Duration = Duration::from_secs(1);
/// And so many times as long as the last one took.
const REST_FACTOR: u32 = 20;

/// Draws what changed.
pub(crate) struct CellArtist {
    viewer: Arc<Viewer>,
    drawings: Arc<CellDrawings>,
    changes: watch::Receiver<u64>,
    /// What is shown.
    drawn: BTreeMap<String, DrawnMap>,
}

impl CellArtist {
    pub(crate) fn new(viewer: Arc<Viewer>, drawings: Arc<CellDrawings>) -> Self {
        let changes = drawings.changes();
        Self { viewer, drawings, changes, drawn: BTreeMap::new() }
    }

    /// Draws the maps that are not shown as they are now.
    pub(crate) async fn draw(&mut self) {
        for (name, map) in self.drawings.maps() {
            if self.drawn.get(&name).is_some_and(|shown| shown.is_like(&map)) {
                continue;
            }
            let (of_map, shown_name) = (map.clone(), name.clone());
            match tokio::task::spawn_blocking(move || of_map.view(&shown_name)).await {
                Ok(view) => self.viewer.set_map(view),
                Err(error) => tracing::error!(name, "these cells of the map are not shown: {error}"),
            }
            self.drawn.insert(name, map);
        }
    }

    /// Draws each change, until it is cancelled.
    pub(crate) async fn follow(mut self) {
        while self.changes.changed().await.is_ok() {
            let begin = Instant::now();
            self.draw().await;
            tokio::time::sleep(REST.max(REST_FACTOR * begin.elapsed())).await;
        }
    }
}
