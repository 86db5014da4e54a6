//! The answers to GET requests, but for the live ones.

use crate::access;
use crate::assets;
use crate::live;
use crate::server::Viewer;
use crate::viewed_map::LANDMARK_BYTES;
use axum::extract::{Path, RawQuery, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use axum::{Json, Router, middleware};
use serde_json::json;
use std::sync::Arc;

/// Landmarks in one answer: 20 MB.
pub const MAX_LANDMARKS: usize = 20_000_000 / LANDMARK_BYTES;

/// The routes of a viewer, and others that are served beside them under the same rules.
pub(crate) fn router(viewer: Arc<Viewer>, beside: Router) -> Router {
    Router::new()
        .route("/", get(|| page_file(Path(String::new()))))
        .route("/{*path}", get(page_file))
        .route("/api/maps", get(maps))
        .route("/api/maps/{map}/keyframes", get(keyframes))
        .route("/api/maps/{map}/landmarks", get(landmarks))
        .route("/api/run", get(run))
        .route("/api/live", get(live::socket))
        .with_state(viewer)
        .merge(beside)
        .layer(middleware::from_fn(access::guard))
}

async fn page_file(Path(path): Path<String>) -> Response {
    match assets::asset(&path) {
        Some(asset) => ([(header::CONTENT_TYPE, asset.media_type)], asset.bytes).into_response(),
        None => not_found("there is no such page").into_response(),
    }
}

fn not_found(what: &str) -> impl IntoResponse {
    (StatusCode::NOT_FOUND, Json(json!({"error": what})))
}

fn unknown_map() -> Response {
    not_found("there is no map of this name; /api/maps lists them").into_response()
}

async fn maps(State(viewer): State<Arc<Viewer>>) -> impl IntoResponse {
    let maps: Vec<_> = viewer.maps().iter().map(|map| map.summary.clone()).collect();
    Json(json!({"maps": maps, "is_run": viewer.run().is_some()}))
}

async fn keyframes(State(viewer): State<Arc<Viewer>>, Path(name): Path<String>) -> Response {
    let Some(map) = viewer.map(&name) else { return unknown_map() };
    Json(json!({"map": name, "version": map.version(), "keyframes": map.keyframes})).into_response()
}

async fn landmarks(
    State(viewer): State<Arc<Viewer>>,
    Path(name): Path<String>,
    RawQuery(query): RawQuery,
) -> Response {
    let Some(map) = viewer.map(&name) else { return unknown_map() };
    let Ok(limit) = landmark_limit(query.as_deref().unwrap_or_default()) else {
        let message = json!({"error": "limit is a number of landmarks, as in ?limit=100000"});
        return (StatusCode::BAD_REQUEST, Json(message)).into_response();
    };
    let end = map.landmarks.len().min(limit.saturating_mul(LANDMARK_BYTES));
    let content_type = [(header::CONTENT_TYPE, "application/octet-stream")];
    (content_type, map.landmarks.slice(..end)).into_response()
}

/// The landmarks asked for, at most [`MAX_LANDMARKS`].
fn landmark_limit(query: &str) -> Result<usize, std::num::ParseIntError> {
    let stated = query.split('&').find_map(|parameter| parameter.strip_prefix("limit="));
    Ok(stated.map_or(Ok(MAX_LANDMARKS), str::parse)?.min(MAX_LANDMARKS))
}

async fn run(State(viewer): State<Arc<Viewer>>) -> Response {
    match viewer.run() {
        Some(run) => Json(run).into_response(),
        None => not_found("no recorded run is shown; driftless view OUT shows one").into_response(),
    }
}
