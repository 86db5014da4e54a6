//! A map server on an endpoint of its own, which can be stopped and started again.

use crate::network;
use client::session::{SessionOptions, close_session, open_session};
use map_server::{MapServer, ServedMap, ServerOptions, ServerStatistics};
use onboard::MapLink;
use prometheus_client::encoding::text::encode;
use prometheus_client::registry::Registry;
use recognition::LoadedMap;
use std::sync::Arc;
use tokio::runtime::Runtime;
use tools::in_process::free_endpoint;

/// Name of the server in its liveliness key.
pub const NAME: &str = "south";

/// A running server.
pub struct Server {
    runtime: Runtime,
    session: zenoh::Session,
    serving: MapServer,
    endpoint: String,
}

impl Server {
    /// Serves one map on a free endpoint.
    pub fn start(name: &str, map: Arc<LoadedMap>) -> Self {
        Self::serve(name, map, free_endpoint().unwrap())
    }

    /// Serves one map on a given endpoint.
    pub fn start_on(endpoint: &str, name: &str, map: Arc<LoadedMap>) -> Self {
        Self::serve(name, map, endpoint.to_owned())
    }

    fn serve(name: &str, map: Arc<LoadedMap>, endpoint: String) -> Self {
        let runtime = network::runtime();
        let options = SessionOptions { listen: vec![endpoint.clone()], ..SessionOptions::default() };
        let session = runtime.block_on(open_session(&options)).unwrap();
        let maps = vec![ServedMap { name: name.to_owned(), map }];
        let mut options = ServerOptions::default();
        options.name = Some(NAME.to_owned());
        let serving = runtime.block_on(MapServer::start(session.clone(), maps, options)).unwrap();
        Self { runtime, session, serving, endpoint }
    }

    /// Where robots connect to.
    pub fn endpoint(&self) -> &str {
        &self.endpoint
    }

    /// What it has done.
    pub fn statistics(&self) -> ServerStatistics {
        self.serving.statistics()
    }

    /// Its metrics as text.
    pub fn metrics(&self) -> String {
        let mut registry = Registry::default();
        self.serving.register_metrics(&mut registry);
        let mut text = String::new();
        encode(&mut text, &registry).unwrap();
        text
    }

    /// Serves another version of a map, and tells robots how far it moved as far as its keyframes tell.
    pub fn replace(&self, name: &str, map: Arc<LoadedMap>) {
        self.runtime.block_on(self.serving.replace(name, map, None)).unwrap();
    }

    /// Stops serving and closes the session, as a server that is told to end.
    pub fn stop(self) {
        self.runtime.block_on(self.serving.stop()).unwrap();
        self.runtime.block_on(close_session(&self.session));
    }
}

/// A client's session with its runtime.
pub struct Client {
    /// Where the session lives.
    pub runtime: Runtime,
    /// The session.
    pub session: zenoh::Session,
}

impl Client {
    /// Connects and waits until the server there says that it is ready.
    pub fn connect(endpoint: &str) -> Self {
        let client = Self::open(&[], &[endpoint]);
        client.wait_for_server(true);
        client
    }

    /// A session to endpoints where there may be nobody.
    pub fn open(listen: &[&str], connect: &[&str]) -> Self {
        let runtime = network::runtime();
        let owned = |endpoints: &[&str]| endpoints.iter().map(|&endpoint| endpoint.to_owned()).collect();
        let options =
            SessionOptions { listen: owned(listen), connect: owned(connect), ..SessionOptions::default() };
        let session = runtime.block_on(open_session(&options)).unwrap();
        Self { runtime, session }
    }

    /// Waits until a server is there, or until none is there any more.
    pub fn wait_for_server(&self, there: bool) {
        self.runtime.block_on(network::wait_for(&self.session, "map_server/*", there));
    }

    /// A robot's way to a map through this session.
    pub fn link(&self, map: &str) -> MapLink {
        MapLink { session: self.session.clone(), runtime: self.runtime.handle().clone(), map: map.to_owned() }
    }

    /// Asks, and waits for the end of the answer.
    pub fn ask(&self, selector: &str, payload: Option<Vec<u8>>) -> Vec<network::Answer> {
        self.runtime.block_on(network::ask(&self.session, selector, payload))
    }

    /// Closes the session.
    pub fn close(self) {
        self.runtime.block_on(close_session(&self.session));
    }
}
