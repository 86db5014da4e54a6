//! The live map in the browser: `--http`.

use std::net::SocketAddr;
use std::sync::Arc;

use anyhow::Context;
use axum::Router;
use map_server::{MapServer, MatchAnswer};
use recognition::LoadedMap;
use tokio::sync::broadcast::Receiver;
use tokio::sync::broadcast::error::RecvError;
use tokio::task::JoinHandle;
use viewer::{Answer, RobotFollower, ViewedMap, Viewer, ViewerServer, follow_robots};
use zenoh::Session;

/// The page of a map server.
pub struct Show {
    viewer: Arc<Viewer>,
    server: ViewerServer,
    answers: JoinHandle<()>,
    _robots: RobotFollower,
}

impl Show {
    /// Shows the maps of a server and the robots of its session, and what is `beside` it.
    pub async fn start(
        address: SocketAddr,
        session: &Session,
        server: &MapServer,
        names: impl Iterator<Item = &str>,
        beside: Router,
    ) -> anyhow::Result<Show> {
        let viewer = Viewer::new();
        for name in names {
            if let Some(map) = server.served(name) {
                viewer.set_map(view(name, &map).await?);
            }
        }
        let robots = follow_robots(&viewer, session).await?;
        let answers = tokio::spawn(show_answers(Arc::clone(&viewer), server.answers()));
        let server =
            ViewerServer::start_with(address, Arc::clone(&viewer), beside).await.context("--http")?;
        Ok(Show { viewer, server, answers, _robots: robots })
    }

    /// Shows the version of a map that is served now.
    pub async fn update(&self, name: &str, server: &MapServer) {
        let Some(map) = server.served(name) else { return };
        if self.viewer.version(name) == Some(map.info().version) {
            return;
        }
        match view(name, &map).await {
            Ok(view) => self.viewer.set_map(view),
            Err(error) => tracing::error!(name, "the page still shows the previous version: {error:#}"),
        }
    }

    /// Stops at once.
    pub async fn stop(self) {
        self.answers.abort();
        self.server.stop().await;
    }
}

/// A large map takes a second: not on a thread that answers queries.
async fn view(name: &str, map: &Arc<LoadedMap>) -> anyhow::Result<ViewedMap> {
    let (name, map) = (name.to_owned(), Arc::clone(map));
    let drawing = move || ViewedMap::new(&name, map.info(), map.keyframes(), map.landmark_positions());
    Ok(tokio::task::spawn_blocking(drawing).await?)
}

async fn show_answers(viewer: Arc<Viewer>, mut answers: Receiver<MatchAnswer>) {
    loop {
        match answers.recv().await {
            Ok(answer) => {
                let shown = Answer { map: answer.map, keyframes: answer.keyframes };
                viewer.note_answer(&answer.client, shown);
            }
            Err(RecvError::Lagged(_)) => {}
            Err(RecvError::Closed) => return,
        }
    }
}
