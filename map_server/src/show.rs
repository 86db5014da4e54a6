//! The live map in the browser: `--http`.

use std::net::SocketAddr;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use axum::Router;
use map::store::StoredImages;
use nalgebra::Vector3;
use protocol::MatchOutcome;
use recognition::{Candidate, KeyframeVerdict, LoadedMap};
use releases::{ReleaseChoice, ReleaseStore};
use tokio::sync::broadcast::Receiver;
use tokio::sync::broadcast::error::RecvError;
use tokio::task::JoinHandle;
use viewer::{
    CandidateVerdict, RobotFollower, RunTracks, ViewedAnswer, ViewedCandidate, ViewedFix, ViewedMap,
    ViewedQuery, ViewedResult, Viewer, ViewerError, ViewerServer, follow_robots,
};
use zenoh::Session;

use crate::reports::{AnsweredQuery, QueryReport};
use crate::server::MapServer;
use crate::show_cells::CellArtist;
use crate::show_releases::ReleaseArtist;
use crate::show_statistics::show_statistics;

/// The page of a map server.
pub struct Show {
    viewer: Arc<Viewer>,
    server: ViewerServer,
    tasks: Vec<JoinHandle<()>>,
    _robots: RobotFollower,
}

impl Show {
    /// Shows the maps of a server and the robots of its session, and what is `beside` it. Maps that are served by cells are shown with the
    /// cells that the server has, as they come and go, where [`ServerOptions::draws_cells`](crate::ServerOptions) says so.
    ///
    /// # Errors
    /// [`ViewerError`]: an address that cannot be listened on, a closed session.
    pub async fn start(
        address: SocketAddr,
        session: &Session,
        server: &MapServer,
        names: impl Iterator<Item = &str>,
        beside: Router,
    ) -> Result<Self, ViewerError> {
        let viewer = Viewer::new();
        viewer.take_images(Arc::new(server.images()));
        for name in names {
            if let Some(map) = server.served(name) {
                set_map(&viewer, name, &map).await;
            }
        }
        let robots = follow_robots(&viewer, session).await?;
        let mut tasks = vec![
            tokio::spawn(show_queries(Arc::clone(&viewer), server.reports())),
            tokio::spawn(show_statistics(Arc::clone(&viewer), server.metrics())),
        ];
        if let Some(drawings) = server.drawings() {
            let mut artist = CellArtist::new(Arc::clone(&viewer), drawings);
            artist.draw().await;
            tasks.push(tokio::spawn(artist.follow()));
        }
        let server = ViewerServer::start_with(address, Arc::clone(&viewer), beside).await?;
        Ok(Self { viewer, server, tasks, _robots: robots })
    }

    /// The address that it listens on.
    pub fn address(&self) -> SocketAddr {
        self.server.address()
    }

    /// Shows the images that a database keeps of a map's keyframes. Where they cannot be read, the log says so, and none are shown.
    pub async fn show_images(&self, name: &str, database: &Path) {
        let path = database.to_owned();
        match tokio::task::spawn_blocking(move || StoredImages::open(path)).await {
            Ok(Ok(images)) => self.viewer.set_keyframe_images(name, Arc::new(Mutex::new(images))),
            Ok(Err(error)) => tracing::warn!(name, "images of keyframes are not shown: {error}"),
            Err(error) => tracing::warn!(name, "images of keyframes are not shown: {error}"),
        }
    }

    /// Shows what changed between the releases of a map, and what a candidate would change.
    ///
    /// # Arguments
    /// * `choice`: which of the store's releases the server follows.
    /// * `period`: time between two looks at the store.
    pub fn follow_releases(
        &mut self,
        name: &str,
        store: ReleaseStore,
        choice: ReleaseChoice,
        period: Duration,
    ) {
        let artist = ReleaseArtist::new(Arc::clone(&self.viewer), name.to_owned(), store, choice);
        self.tasks.push(tokio::spawn(artist.follow(period)));
    }

    /// Offers a recorded run to those who look at the page, in place of the one before.
    pub fn set_run(&self, run: &RunTracks) {
        self.viewer.set_run(run);
    }

    /// Shows the version of a map that is served now.
    ///
    /// # Returns
    /// Whether it was another one.
    pub async fn update(&self, name: &str, server: &MapServer) -> bool {
        let Some(map) = server.served(name) else { return false };
        let is_new = self.viewer.version(name) != Some(map.info().version);
        if is_new {
            set_map(&self.viewer, name, &map).await;
        }
        is_new
    }

    /// Stops at once.
    pub async fn stop(self) {
        for task in self.tasks {
            task.abort();
        }
        self.server.stop().await;
    }
}

/// A large map takes a second: not on a thread that answers queries.
async fn set_map(viewer: &Viewer, name: &str, map: &Arc<LoadedMap>) {
    let (shown_name, map) = (name.to_owned(), Arc::clone(map));
    let drawing = move || {
        let keyframes = map.keyframes().map(|keyframe| (keyframe, map.stated_aliases(keyframe.id)));
        ViewedMap::new(&shown_name, map.info(), keyframes, map.landmark_positions())
    };
    match tokio::task::spawn_blocking(drawing).await {
        Ok(view) => viewer.set_map(view),
        Err(error) => tracing::error!(name, "this version of the map is not shown: {error}"),
    }
}

async fn show_queries(viewer: Arc<Viewer>, mut reports: Receiver<QueryReport>) {
    loop {
        match reports.recv().await {
            Ok(report) => {
                let client = report.client.clone();
                viewer.note_query(&client, viewed(report));
            }
            Err(RecvError::Lagged(missed)) => tracing::debug!(missed, "queries are not shown: too many"),
            Err(RecvError::Closed) => return,
        }
    }
}

/// A query as the page shows it.
fn viewed(report: QueryReport) -> ViewedQuery {
    let result = match report.result {
        Ok(answered) => ViewedResult::Answered(Box::new(viewed_answer(&answered))),
        Err(error) => ViewedResult::Failed { error: error.code, message: error.message },
    };
    let duration_ms = report.duration.as_secs_f64() * 1e3;
    ViewedQuery { kind: report.kind, map: report.map, duration_ms, result }
}

pub(crate) fn viewed_answer(answered: &AnsweredQuery) -> ViewedAnswer {
    // JSON knows no infinity.
    let finite =
        |position: Vector3<f64>| position.iter().all(|value| value.is_finite()).then(|| position.into());
    // Of several places that look alike none is where the camera is.
    let is_matched = answered.outcome == MatchOutcome::Matched;
    let camera_in_global = answered.search.camera_in_global().filter(|_| is_matched);
    ViewedAnswer {
        outcome: answered.outcome,
        map_version: answered.map_version,
        stamp_ns: answered.stamp_ns,
        features: answered.features,
        keyframes: answered.keyframes.clone(),
        prior_in_global: answered.prior_in_global.and_then(finite),
        camera_in_global: camera_in_global.and_then(finite),
        fix: answered.fix.as_ref().map(ViewedFix::of),
        candidates: answered.search.candidates.iter().map(viewed_candidate).collect(),
    }
}

fn viewed_candidate(candidate: &Candidate) -> ViewedCandidate {
    ViewedCandidate {
        keyframe: candidate.keyframe,
        near_prior: candidate.near_prior,
        votes: candidate.votes,
        matches: candidate.matches,
        inliers: candidate.inliers,
        mean_error_px: candidate.mean_error_px,
        verdict: match candidate.verdict {
            None => CandidateVerdict::NotCompared,
            Some(KeyframeVerdict::TooFewMatches) => CandidateVerdict::TooFewMatches,
            Some(KeyframeVerdict::NoPose) => CandidateVerdict::NoPose,
            Some(KeyframeVerdict::PoseUncertain) => CandidateVerdict::PoseUncertain,
            Some(KeyframeVerdict::Verified) if candidate.in_answer => CandidateVerdict::InAnswer,
            Some(KeyframeVerdict::Verified) => CandidateVerdict::Verified,
        },
    }
}
