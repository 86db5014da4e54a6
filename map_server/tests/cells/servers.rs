//! Servers of cells in this process, and a router between them.

use std::path::Path;
use std::time::{Duration, Instant};

use client::{SessionOptions, open_session};
use map_server::{CellChoice, CellService, CellServiceOptions, MapServer, ServerOptions};
use releases::ReleaseStore;
use zenoh::Session;

pub async fn session(connect: &str) -> Session {
    let options = SessionOptions { connect: vec![connect.to_owned()], ..SessionOptions::default() };
    open_session(&options).await.unwrap()
}

/// The server of others: a router without a map.
pub async fn hub() -> (Session, String) {
    loop {
        let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let endpoint = format!("tcp/127.0.0.1:{port}");
        let mut config = zenoh::Config::default();
        config.insert_json5("mode", "\"router\"").unwrap();
        config.insert_json5("listen/endpoints", &format!("[\"{endpoint}\"]")).unwrap();
        config.insert_json5("scouting/multicast/enabled", "false").unwrap();
        if let Ok(session) = zenoh::open(config).await {
            return (session, endpoint);
        }
    }
}

pub struct CellServer {
    pub session: Session,
    pub server: MapServer,
    service: CellService,
}

impl CellServer {
    pub async fn start(
        endpoint: &str,
        name: &str,
        store: &ReleaseStore,
        folder: &Path,
        choice: CellChoice,
    ) -> Self {
        Self::with_memory(endpoint, name, store, folder, choice, None).await
    }

    /// With a bound on the memory of its cells, bytes.
    pub async fn with_memory(
        endpoint: &str,
        name: &str,
        store: &ReleaseStore,
        folder: &Path,
        choice: CellChoice,
        memory: Option<usize>,
    ) -> Self {
        let session = session(endpoint).await;
        let mut options = ServerOptions::default();
        options.name = Some(name.to_owned());
        options.cell_memory = memory;
        options.draws_cells = true;
        let server = MapServer::start(session.clone(), Vec::new(), options).await.unwrap();
        let mut options = CellServiceOptions::new(folder.join(name));
        options.choice = choice;
        options.watch = Duration::from_millis(300);
        let service = CellService::start(&server, "city", store.clone(), options).await.unwrap();
        Self { session, server, service }
    }

    pub async fn stop(self) {
        self.service.stop().await;
        self.server.stop().await.unwrap();
        self.session.close().await.unwrap();
    }
}

/// Waits until so many tokens are alive.
pub async fn wait_for(client: &Session, keys: &str, count: usize) {
    let begin = Instant::now();
    loop {
        let tokens = client.liveliness().get(keys).await.unwrap();
        let mut found = 0;
        while tokens.recv_async().await.is_ok() {
            found += 1;
        }
        if found == count {
            return;
        }
        assert!(begin.elapsed() < Duration::from_mins(1), "{found} of {count} tokens at {keys}");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

/// Waits until so many cells are at servers, each counted for each of them.
pub async fn wait_for_cells(client: &Session, count: usize) {
    wait_for(client, "map/city/cell/*/server/*", count).await;
}

pub async fn wait_for_members(client: &Session, count: usize) {
    wait_for(client, "map/city/server/*", count).await;
}
