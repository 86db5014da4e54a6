//! The WebSocket of one viewer.

use crate::server::Viewer;
use axum::extract::State;
use axum::extract::ws::{Message, Utf8Bytes, WebSocket, WebSocketUpgrade};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::broadcast::error::RecvError;
use tokio::time::{interval, timeout};

/// Longest message of a viewer, bytes: it has nothing to say.
const MAX_INCOMING: usize = 1024;
/// A viewer that takes no message for this long is gone.
const SEND_TIMEOUT: Duration = Duration::from_secs(10);
/// Time between two pings: shorter than connections may be idle.
const PING: Duration = Duration::from_secs(15);

pub(crate) async fn socket(State(viewer): State<Arc<Viewer>>, upgrade: WebSocketUpgrade) -> Response {
    let Ok(place) = Arc::clone(&viewer.live.viewers).try_acquire_owned() else {
        let message = "too many viewers: close a page of this map elsewhere\n";
        return (StatusCode::SERVICE_UNAVAILABLE, message).into_response();
    };
    let upgrade = upgrade.max_message_size(MAX_INCOMING).max_frame_size(MAX_INCOMING);
    upgrade.on_upgrade(|socket| async move {
        show(&viewer, socket).await;
        drop(place);
    })
}

/// Sends what changes until the viewer is gone.
async fn show(viewer: &Viewer, mut socket: WebSocket) {
    // Before the snapshot, so that nothing between the two is missed.
    let mut updates = viewer.live.updates.subscribe();
    let mut next = Message::Text(viewer.live.snapshot());
    let mut pings = interval(PING);
    loop {
        if !matches!(timeout(SEND_TIMEOUT, socket.send(next)).await, Ok(Ok(()))) {
            return;
        }
        next = loop {
            tokio::select! {
                received = socket.recv() => match received {
                    Some(Ok(Message::Close(_)) | Err(_)) | None => return,
                    Some(Ok(_)) => {}
                },
                update = updates.recv() => match update {
                    Ok(update) => break Message::Text(update),
                    Err(RecvError::Lagged(_)) => {
                        updates = updates.resubscribe();
                        let snapshot: Utf8Bytes = viewer.live.snapshot();
                        break Message::Text(snapshot);
                    }
                    Err(RecvError::Closed) => return,
                },
                _ = pings.tick() => break Message::Ping(axum::body::Bytes::new()),
            }
        };
    }
}
