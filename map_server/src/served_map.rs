//! A map and its name, and the slot that holds it while it is served.

use std::sync::{Arc, PoisonError, RwLock};

use recognition::LoadedMap;

/// A map and the name under which it is served.
pub struct ServedMap {
    /// One chunk of a key: see [`protocol::keys::validate_name`].
    pub name: String,
    /// The map.
    pub map: Arc<LoadedMap>,
}

/// A map that can be replaced while it is served; a query is answered with the one that it started with.
pub(crate) struct MapSlot {
    pub(crate) name: String,
    map: RwLock<Arc<LoadedMap>>,
    /// Held from the comparison with the served version until the notice of the new one has left.
    pub(crate) changing: tokio::sync::Mutex<()>,
}

impl MapSlot {
    pub(crate) fn new(ServedMap { name, map }: ServedMap) -> MapSlot {
        MapSlot { name, map: RwLock::new(map), changing: tokio::sync::Mutex::default() }
    }

    pub(crate) fn current(&self) -> Arc<LoadedMap> {
        Arc::clone(&self.map.read().unwrap_or_else(PoisonError::into_inner))
    }

    /// Exchanges the map and returns the previous one.
    pub(crate) fn replace(&self, map: Arc<LoadedMap>) -> Arc<LoadedMap> {
        std::mem::replace(&mut *self.map.write().unwrap_or_else(PoisonError::into_inner), map)
    }
}
