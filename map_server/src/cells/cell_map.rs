//! The cells of a map that a server has: declared, replaced, withdrawn.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use client::CellClient;
use protocol::keys;
use releases::CellId;
use zenoh::liveliness::LivelinessToken;
use zenoh::query::{Query, Queryable};

use super::drawings::DrawnMap;
use super::stored_cell::{CellSlot, StoredCell};
use crate::error::ServeError;
use crate::host::Host;
use crate::kind::{CellKind, Kind};
use crate::queue::{Job, Target};
use crate::routing::{CellDirectory, RoutedMap};

/// A map that is served by cells. What it declared is undeclared when it is dropped.
pub(crate) struct CellMap {
    host: Host,
    routed: Arc<RoutedMap>,
    held: BTreeMap<CellId, HeldCell>,
    version: LivelinessToken,
    _queryables: Vec<Queryable<()>>,
    _member: LivelinessToken,
}

struct HeldCell {
    slot: Arc<CellSlot>,
    // In the order in which they are undeclared.
    _token: LivelinessToken,
    _queryables: Vec<Queryable<()>>,
}

impl CellMap {
    /// Answers queries about the map, without a cell of its own yet.
    pub(crate) async fn start(
        host: Host,
        name: &str,
        directory: Arc<CellDirectory>,
    ) -> Result<CellMap, ServeError> {
        let client = CellClient::new(host.session.clone(), name)?;
        let version = version_token(&host, name, directory.version()).await?;
        host.metrics.note_map(name, directory.keyframe_count(), directory.version());
        let routed = Arc::new(RoutedMap::new(name, client, host.options.clone(), directory));
        let mut queryables = Vec::new();
        for kind in Kind::ALL {
            let (queue, routed) = (Arc::clone(&host.queue), Arc::clone(&routed));
            let callback = move |query: Query| {
                queue.put(Job::new(query, Target::Routed(kind, Arc::clone(&routed))));
            };
            let queryable = host.session.declare_queryable(kind.key(name)?).callback(callback);
            queryables.push(queryable.complete(true).await?);
        }
        let key = keys::map_member(name, Some(&host.server))?;
        let member = host.session.liveliness().declare_token(key).await?;
        let map = CellMap {
            host,
            routed,
            held: BTreeMap::new(),
            version,
            _queryables: queryables,
            _member: member,
        };
        map.draw();
        Ok(map)
    }

    pub(crate) fn directory(&self) -> Arc<CellDirectory> {
        self.routed.directory()
    }

    /// The cells that this server has.
    pub(crate) fn cells(&self) -> BTreeSet<CellId> {
        self.held.keys().copied().collect()
    }

    /// Has the live map draw the cells that this server has now.
    fn draw(&self) {
        let Some(drawings) = &self.host.drawings else { return };
        let directory = self.routed.directory();
        let part = |(cell, held): (&CellId, &HeldCell)| Some((*cell, held.slot.current().drawing()?));
        let cells = self.held.iter().filter_map(part).collect();
        let (info, all_cells) = (directory.info().clone(), directory.cells().count());
        drawings.set(&self.routed.name, DrawnMap { info, all_cells, cells });
    }

    /// Serves cells from now on.
    pub(crate) async fn add(
        &mut self,
        cells: impl IntoIterator<Item = (CellId, Arc<StoredCell>)>,
    ) -> Result<(), ServeError> {
        let mut added = Ok(());
        for (cell, stored) in cells {
            added = added.and(self.declare(cell, stored).await);
        }
        self.draw();
        added
    }

    async fn declare(&mut self, cell: CellId, stored: Arc<StoredCell>) -> Result<(), ServeError> {
        let name = &self.routed.name;
        let slot = Arc::new(CellSlot::new(name, cell, stored));
        let mut queryables = Vec::new();
        for kind in CellKind::ALL {
            let (queue, slot) = (Arc::clone(&self.host.queue), Arc::clone(&slot));
            let callback = move |query: Query| {
                queue.put(Job::new(query, Target::Cell(kind, Arc::clone(&slot))));
            };
            let queryable = self.host.session.declare_queryable(kind.key(name, cell)?).callback(callback);
            queryables.push(queryable.complete(true).await?);
        }
        let key = keys::cell_holder(name, Some(cell), Some(&self.host.server))?;
        let token = self.host.session.liveliness().declare_token(key).await?;
        self.held.insert(cell, HeldCell { slot, _token: token, _queryables: queryables });
        self.routed.set_here(self.cells());
        Ok(())
    }

    /// Serves a cell no more.
    pub(crate) fn remove(&mut self, cell: CellId) {
        if let Some(held) = self.held.remove(&cell) {
            self.routed.set_here(self.cells());
            drop(held);
            self.host.memory.note_gone();
            self.draw();
        }
    }

    /// Tells the other servers that another version is loaded; the former one is declared until the change.
    pub(crate) async fn announce(&self, version: u64) -> Result<LivelinessToken, ServeError> {
        version_token(&self.host, &self.routed.name, version).await
    }

    /// Changes over to another version of the map.
    ///
    /// # Arguments
    /// * `cells`: of the new version; those that the server has and that are not among them are withdrawn.
    /// * `version`: of [`CellMap::announce`].
    ///
    /// # Returns
    /// The cells that it did not have, which are still to be [added](CellMap::add).
    #[must_use]
    pub(crate) fn change_over(
        &mut self,
        directory: Arc<CellDirectory>,
        cells: BTreeMap<CellId, Arc<StoredCell>>,
        version: LivelinessToken,
    ) -> Vec<(CellId, Arc<StoredCell>)> {
        for cell in self.cells().into_iter().filter(|cell| !cells.contains_key(cell)) {
            self.remove(cell);
        }
        self.host.metrics.note_map(&self.routed.name, directory.keyframe_count(), directory.version());
        let mut new = Vec::new();
        for (cell, stored) in cells {
            match self.held.get(&cell) {
                Some(held) => {
                    let former = held.slot.replace(Arc::clone(&stored));
                    stored.warm_up(&former);
                }
                None => new.push((cell, stored)),
            }
        }
        self.host.memory.note_gone();
        self.routed.set_directory(directory);
        self.version = version;
        new
    }
}

async fn version_token(host: &Host, name: &str, version: u64) -> Result<LivelinessToken, ServeError> {
    let key = keys::version_holder(name, version, Some(&host.server))?;
    Ok(host.session.liveliness().declare_token(key).await?)
}
