//! The answers to GET requests, but for the live ones.

use crate::access;
use crate::assets;
use crate::cameras::CameraAnswer;
use crate::history::MAX_ANSWER_SAMPLES;
use crate::keyframe_images;
use crate::live;
use crate::parameters::{number, parameter};
use crate::queries::{DatedQuery, MAX_QUERIES};
use crate::server::Viewer;
use crate::statistics::STATISTICS_PERIOD;
use crate::upload;
use crate::viewed_map::{LANDMARK_BYTES, MAX_LANDMARKS, MapSummary, ViewedMap};
use axum::body::Bytes;
use axum::extract::{Path, RawQuery, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Json, Router, middleware};
use serde::Serialize;
use serde_json::json;
use std::sync::Arc;

/// Queries in one answer, where it does not say how many.
const DEFAULT_QUERIES: usize = 50;
/// Bytes of a query and of a sample in an answer, about.
const QUERY_BYTES: usize = 4096;
const SAMPLE_BYTES: usize = 280;

/// The routes of a viewer, and others that are served beside them under the same rules.
pub(crate) fn router(viewer: Arc<Viewer>, beside: Router) -> Router {
    Router::new()
        .route("/", get(|| page_file(Path(String::new()))))
        .route("/{*path}", get(page_file))
        .route("/api/maps", get(maps))
        .route("/api/maps/{map}/keyframes", get(keyframes))
        .route("/api/maps/{map}/keyframes/{keyframe}/image", get(keyframe_images::image))
        .route("/api/maps/{map}/landmarks", get(landmarks))
        .route("/api/maps/{map}/cameras", get(cameras))
        .route("/api/maps/{map}/changes", get(changes))
        .route("/api/maps/{map}/localize", post(upload::localize))
        .route("/api/run", get(run))
        .route("/api/queries", get(queries))
        .route("/api/history", get(history))
        .route("/api/statistics", get(statistics))
        .route("/api/live", get(live::socket))
        .with_state(viewer)
        .merge(beside)
        .layer(middleware::from_fn(access::guard))
}

async fn page_file(Path(path): Path<String>) -> Response {
    match assets::asset(&path) {
        Some(asset) => ([(header::CONTENT_TYPE, asset.media_type)], asset.bytes).into_response(),
        None => not_found("there is no such page"),
    }
}

/// An answer that says what is wrong.
pub(crate) fn error(status: StatusCode, what: &str) -> Response {
    (status, Json(json!({"error": what}))).into_response()
}

fn not_found(what: &str) -> Response {
    error(StatusCode::NOT_FOUND, what)
}

fn bad_request(what: &str) -> Response {
    error(StatusCode::BAD_REQUEST, what)
}

/// Reply where there is no map of the name in the request.
pub(crate) const UNKNOWN_MAP: &str = "there is no map of this name; /api/maps lists them";

fn unknown_map() -> Response {
    not_found(UNKNOWN_MAP)
}

fn json_bytes(bytes: Bytes) -> Response {
    ([(header::CONTENT_TYPE, "application/json")], bytes).into_response()
}

/// An answer that is made for one reader: only so many of them are in memory at the same time.
///
/// `bytes`: about its length.
async fn large<T: Serialize>(viewer: &Viewer, bytes: usize, answer: impl FnOnce() -> T) -> Response {
    let held = match viewer.outbox.reserve(bytes).await {
        // Its values are finite, so that it can always be written.
        Some(room) => room.hold(serde_json::to_vec(&answer()).unwrap_or_default()),
        None => None,
    };
    held.map_or_else(
        || {
            error(
                StatusCode::SERVICE_UNAVAILABLE,
                "too many large answers are being read: try again in a moment",
            )
        },
        json_bytes,
    )
}

/// A map in `/api/maps`.
#[derive(Serialize)]
struct ListedMap {
    #[serde(flatten)]
    summary: MapSummary,
    /// How many keyframes have an image here.
    keyframe_images: usize,
}

async fn maps(State(viewer): State<Arc<Viewer>>) -> impl IntoResponse {
    let listed = |map: &Arc<ViewedMap>| {
        let keyframe_images = viewer.keyframe_images(map.name()).map_or(0, |images| images.count());
        ListedMap { summary: map.summary.clone(), keyframe_images }
    };
    let maps: Vec<ListedMap> = viewer.maps().iter().map(listed).collect();
    Json(json!({
        "maps": maps,
        "is_run": viewer.run().is_some(),
        "is_live": viewer.is_live(),
        "takes_images": viewer.images().is_some(),
    }))
}

async fn keyframes(State(viewer): State<Arc<Viewer>>, Path(name): Path<String>) -> Response {
    let Some(map) = viewer.map(&name) else { return unknown_map() };
    json_bytes(map.keyframes.clone())
}

async fn cameras(State(viewer): State<Arc<Viewer>>, Path(name): Path<String>) -> Response {
    let Some(map) = viewer.map(&name) else { return unknown_map() };
    let cameras: Vec<_> = map.cameras.iter().enumerate().map(CameraAnswer::of).collect();
    Json(json!({"map": name, "version": map.version(), "cameras": cameras})).into_response()
}

async fn changes(State(viewer): State<Arc<Viewer>>, Path(name): Path<String>) -> Response {
    match viewer.changes(&name) {
        Some(changes) => json_bytes(changes),
        None => unknown_map(),
    }
}

async fn landmarks(
    State(viewer): State<Arc<Viewer>>,
    Path(name): Path<String>,
    RawQuery(query): RawQuery,
) -> Response {
    let Some(map) = viewer.map(&name) else { return unknown_map() };
    let Ok(limit) = number(query.as_deref().unwrap_or_default(), "limit") else {
        return bad_request("limit is a number of landmarks, as in ?limit=100000");
    };
    let limit = limit.map_or(MAX_LANDMARKS, |limit| limit.min(MAX_LANDMARKS as u64) as usize);
    let end = map.landmarks.len().min(limit.saturating_mul(LANDMARK_BYTES));
    let content_type = [(header::CONTENT_TYPE, "application/octet-stream")];
    (content_type, map.landmarks.slice(..end)).into_response()
}

async fn queries(State(viewer): State<Arc<Viewer>>, RawQuery(query): RawQuery) -> Response {
    let query = query.unwrap_or_default();
    let (Ok(after), Ok(limit)) = (number(&query, "after"), number(&query, "limit")) else {
        return bad_request("after and limit are numbers, as in ?robot=r7&after=310&limit=50");
    };
    let limit = limit.map_or(DEFAULT_QUERIES, |limit| limit.min(MAX_QUERIES as u64) as usize);
    let robot = parameter(&query, "robot");
    let newest = viewer.live.newest_queries(robot.as_deref(), after.unwrap_or(0), limit);
    let started_ms = viewer.live.started_ms();
    let queries: Vec<_> = newest.iter().map(|query| query.since_1970(started_ms)).collect();
    let answer = || Queries { now_ms: viewer.live.now_ms(), queries: &queries };
    large(&viewer, QUERY_BYTES * queries.len(), answer).await
}

/// The answer to `/api/queries`.
#[derive(Serialize)]
struct Queries<'a> {
    now_ms: u64,
    queries: &'a [DatedQuery<'a>],
}

async fn history(State(viewer): State<Arc<Viewer>>, RawQuery(query): RawQuery) -> Response {
    let query = query.unwrap_or_default();
    let read = |name| number(&query, name);
    let (Ok(from_ms), Ok(to_ms), Ok(samples)) = (read("from"), read("to"), read("samples")) else {
        return bad_request(
            "from and to are milliseconds since 1970, samples is their number, at most 20000",
        );
    };
    let limit = samples.map_or(MAX_ANSWER_SAMPLES, |samples| samples.min(MAX_ANSWER_SAMPLES as u64) as usize);
    let map = parameter(&query, "map");
    let live = &viewer.live;
    let span = (from_ms.unwrap_or(0), to_ms.unwrap_or(u64::MAX));
    let answer =
        || Timed { now_ms: live.now_ms(), value: live.history(span.0, span.1, map.as_deref(), limit) };
    large(&viewer, SAMPLE_BYTES * limit, answer).await
}

/// An answer and the server's time.
#[derive(Serialize)]
struct Timed<T> {
    now_ms: u64,
    #[serde(flatten)]
    value: T,
}

async fn statistics(State(viewer): State<Arc<Viewer>>) -> impl IntoResponse {
    let (now_ms, samples) = (viewer.live.now_ms(), viewer.live.statistics());
    Json(json!({"now_ms": now_ms, "period_s": STATISTICS_PERIOD.as_secs_f64(), "samples": samples}))
}

async fn run(State(viewer): State<Arc<Viewer>>) -> Response {
    match viewer.run() {
        Some(run) => json_bytes(run),
        None => not_found("no recorded run is shown; driftless view DIR shows one"),
    }
}
