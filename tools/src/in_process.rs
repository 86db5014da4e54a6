//! A map server and robots in one process, over Zenoh on the loopback interface.

use anyhow::{Context as _, Result};
use client::session::{SessionOptions, close_session, open_session};
use map::store;
use map_server::{MapServer, ServedMap, ServerOptions};
use onboard::MapLink;
use recognition::LoadedMap;
use std::net::TcpListener;
use std::path::Path;
use std::sync::Arc;
use tokio::runtime::Runtime;

/// Loads a map database into memory, ready to be served.
///
/// # Errors
/// A database that cannot be opened or read; the error names it.
pub fn load_map(database: &Path) -> Result<Arc<LoadedMap>> {
    let map =
        LoadedMap::load(store::load_map(database)?).with_context(|| format!("map {}", database.display()))?;
    Ok(Arc::new(map))
}

/// A running server with its own runtime and session.
pub struct LocalServer {
    runtime: Runtime,
    session: zenoh::Session,
    server: Option<MapServer>,
    endpoint: String,
}

impl LocalServer {
    /// Serves `maps` on a free port of the loopback interface.
    ///
    /// # Errors
    /// No free port, or an error of Zenoh.
    pub fn start(maps: Vec<(String, Arc<LoadedMap>)>) -> Result<Self> {
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
        let endpoint = free_endpoint()?;
        let options = SessionOptions { listen: vec![endpoint.clone()], ..SessionOptions::default() };
        let session = runtime.block_on(open_session(&options))?;
        let maps = maps.into_iter().map(|(name, map)| ServedMap { name, map }).collect();
        let server = runtime.block_on(MapServer::start(session.clone(), maps, ServerOptions::default()))?;
        Ok(Self { runtime, session, server: Some(server), endpoint })
    }

    /// The endpoint that robots connect to.
    pub fn endpoint(&self) -> &str {
        &self.endpoint
    }

    /// Opens a session of a robot to this server.
    ///
    /// # Errors
    /// Zenoh's.
    pub fn link(&self, map: &str) -> Result<MapLink> {
        let options = SessionOptions { connect: vec![self.endpoint.clone()], ..SessionOptions::default() };
        let session = self.runtime.block_on(open_session(&options))?;
        Ok(MapLink { session, runtime: self.runtime.handle().clone(), map: map.to_owned() })
    }

    /// Closes a robot's session.
    pub fn unlink(&self, link: &MapLink) {
        self.runtime.block_on(close_session(&link.session));
    }

    /// Stops serving and closes the session.
    ///
    /// # Errors
    /// Zenoh's.
    pub fn stop(mut self) -> Result<()> {
        let stopped = match self.server.take() {
            Some(server) => self.runtime.block_on(server.stop()),
            None => Ok(()),
        };
        self.runtime.block_on(close_session(&self.session));
        Ok(stopped?)
    }
}

/// An endpoint on the loopback interface whose port is free now.
///
/// # Errors
/// The system has no free port.
pub fn free_endpoint() -> Result<String> {
    let listener = TcpListener::bind("127.0.0.1:0").context("no free port on the loopback interface")?;
    Ok(format!("tcp/{}", listener.local_addr()?))
}
