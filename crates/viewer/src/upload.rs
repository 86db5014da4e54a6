//! The answer to a POST of an image.

use crate::api::{UNKNOWN_MAP, error};
use crate::images::{GivenImage, ImageCamera, ImageError, MAX_IMAGE_BYTES};
use crate::parameters::{number, parameter};
use crate::queries::{KeptQuery, ViewedQuery, ViewedResult};
use crate::server::Viewer;
use crate::viewed_map::ViewedMap;
use axum::Json;
use axum::body::{Body, Bytes, HttpBody as _};
use axum::extract::{Path, RawQuery, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse as _, Response};
use std::future::poll_fn;
use std::pin::Pin;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::time::timeout;

/// Longest calibration, bytes.
const MAX_CALIBRATION_BYTES: usize = 16 << 10;
/// How long the upload of an image may take.
const UPLOAD: Duration = Duration::from_secs(30);
/// Bytes of a refused upload that are read and thrown away: a browser shows no answer that comes before it has sent all.
const MAX_DISCARDED_BYTES: usize = 4 * MAX_IMAGE_BYTES;
/// Who asks, in the list of queries.
const CLIENT: &str = "page";

/// Why an upload ended without an image.
enum Incomplete {
    TooLarge,
    Broken,
}

/// What is wrong with a request, or with its image.
struct Refusal(StatusCode, String);

fn refusal(status: StatusCode, what: &str) -> Refusal {
    Refusal(status, what.to_owned())
}

/// `POST /api/maps/{map}/localize?camera=NUMBER`, or with `calibration=TEXT` in place of the camera.
pub(crate) async fn localize(
    State(viewer): State<Arc<Viewer>>,
    Path(name): Path<String>,
    RawQuery(query): RawQuery,
    mut body: Body,
) -> Response {
    match accept(&viewer, &name, query.as_deref().unwrap_or_default(), &mut body).await {
        Ok(kept) => Json(kept.since_1970(viewer.live.started_ms())).into_response(),
        Err(Refusal(status, what)) => {
            let _ = timeout(UPLOAD, read(&mut body, MAX_DISCARDED_BYTES, |_| ())).await;
            error(status, &what)
        }
    }
}

async fn accept(
    viewer: &Arc<Viewer>,
    name: &str,
    query: &str,
    body: &mut Body,
) -> Result<Arc<KeptQuery>, Refusal> {
    let no_search = "this server does not localize images; map_server --http does";
    let images = viewer.images().ok_or_else(|| refusal(StatusCode::NOT_FOUND, no_search))?;
    let map = viewer.map(name).ok_or_else(|| refusal(StatusCode::NOT_FOUND, UNKNOWN_MAP))?;
    let camera = chosen_camera(&map, query)?;
    let busy = "another image is being localized: try again in a moment";
    let turn = Arc::clone(&viewer.image_turn).try_acquire_owned();
    let turn = turn.map_err(|_| refusal(StatusCode::TOO_MANY_REQUESTS, busy))?;
    let file = upload(body).await?;
    let image = GivenImage { map: name.to_owned(), file, camera };
    let received = Instant::now();
    let search = move || {
        let found = images.localize(&image);
        // The next one may come, also where nobody waits for this answer any more.
        drop(turn);
        found
    };
    let found = tokio::task::spawn_blocking(search).await.map_err(|panic| {
        tracing::error!("an image could not be localized: {panic}");
        refusal(StatusCode::INTERNAL_SERVER_ERROR, "the server failed on this image; its log says more")
    })?;
    let answer = found.map_err(|problem| match problem {
        ImageError::UnknownMap(_) => Refusal(StatusCode::NOT_FOUND, problem.to_string()),
        ImageError::Unusable(_) => Refusal(StatusCode::UNPROCESSABLE_ENTITY, problem.to_string()),
    })?;
    let duration_ms = received.elapsed().as_secs_f64() * 1e3;
    let result = ViewedResult::Answered(Box::new(answer));
    let query = ViewedQuery { kind: "image", map: name.to_owned(), duration_ms, result };
    Ok(viewer.live.note_query(CLIENT, query))
}

/// The camera that the request names.
fn chosen_camera(map: &ViewedMap, query: &str) -> Result<ImageCamera, Refusal> {
    let refused = |what: &str| refusal(StatusCode::BAD_REQUEST, what);
    if let Some(calibration) = parameter(query, "calibration") {
        if calibration.len() > MAX_CALIBRATION_BYTES {
            return Err(refused("the calibration is longer than 16 KiB; give that of the camera only"));
        }
        return Ok(ImageCamera::Calibration(calibration));
    }
    let wanted = number(query, "camera").map_err(|_| refused("camera is a number, as in ?camera=0"))?;
    let at = usize::try_from(wanted.unwrap_or(0)).unwrap_or(usize::MAX);
    let unknown =
        || refused(&format!("the map has no such camera; /api/maps/{}/cameras lists them", map.name()));
    Ok(ImageCamera::OfMap(map.cameras.get(at).ok_or_else(unknown)?.camera.clone()))
}

/// The whole file of an image.
async fn upload(body: &mut Body) -> Result<Bytes, Refusal> {
    let mut file = Vec::new();
    let received = timeout(UPLOAD, read(body, MAX_IMAGE_BYTES, |part| file.extend_from_slice(&part))).await;
    let (status, what) = match received {
        Ok(Ok(())) if is_image(&file) => return Ok(file.into()),
        Ok(Ok(())) => (StatusCode::UNSUPPORTED_MEDIA_TYPE, "this is neither a PNG nor a JPEG image"),
        Ok(Err(Incomplete::TooLarge)) => (
            StatusCode::PAYLOAD_TOO_LARGE,
            "the image is larger than 4 MiB: save it with stronger compression, as JPEG for example",
        ),
        Ok(Err(Incomplete::Broken)) => (StatusCode::BAD_REQUEST, "the upload ended before the image did"),
        Err(_) => (StatusCode::REQUEST_TIMEOUT, "the upload took longer than 30 s"),
    };
    Err(refusal(status, what))
}

fn is_image(file: &[u8]) -> bool {
    file.starts_with(b"\x89PNG\r\n\x1a\n") || file.starts_with(&[0xff, 0xd8, 0xff])
}

/// Reads a body part by part.
async fn read(body: &mut Body, limit: usize, mut take: impl FnMut(Bytes)) -> Result<(), Incomplete> {
    if body.size_hint().lower() > limit as u64 {
        return Err(Incomplete::TooLarge);
    }
    let mut bytes = 0;
    while let Some(frame) = poll_fn(|context| Pin::new(&mut *body).poll_frame(context)).await {
        let Ok(part) = frame.map_err(|_| Incomplete::Broken)?.into_data() else { continue };
        bytes += part.len();
        if bytes > limit {
            return Err(Incomplete::TooLarge);
        }
        take(part);
    }
    Ok(())
}
