//! Opening and closing a session.

use super::error::SessionError;
use super::{SessionMode, SessionOptions, checks};
use std::time::Duration;

/// How long closing a session may take.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(5);

/// Opens a session, and logs what it is in the network.
///
/// A client is open when it is connected, and waits for that as long as it takes: drop the future to give up. A peer or
/// router is open as soon as it listens; connecting continues in the background. Connections that are lost are made
/// again.
///
/// Needs a multi-threaded tokio runtime, as Zenoh does.
///
/// # Errors
/// [`SessionError`]: an unusable option, or an endpoint that cannot be listened on.
pub async fn open_session(options: &SessionOptions) -> Result<zenoh::Session, SessionError> {
    let settings = options.settings()?;
    let config = options.zenoh_config(&settings)?;
    let of = |key| checks::endpoints(&settings, key).into_iter().map(str::to_owned).collect::<Vec<_>>();
    let (listen, connect) = (of("/listen/endpoints"), of("/connect/endpoints"));
    let mode = settings["mode"].as_str().unwrap_or_default();
    let namespace = settings["namespace"].as_str().unwrap_or("(none)");
    tracing::info!(mode, ?listen, ?connect, namespace, "opening the session");
    let is_client = mode == SessionMode::Client.name();
    if is_client {
        tracing::info!("a client waits until it is connected");
    }
    let session = zenoh::open(config)
        .await
        .map_err(|problem| SessionError::Open { listen, problem: problem.to_string() })?;
    if is_client {
        tracing::info!("connected");
    }
    Ok(session)
}

/// Closes a session; returns after 5 s at the latest, if the other side does not respond.
pub async fn close_session(session: &zenoh::Session) {
    match tokio::time::timeout(CLOSE_TIMEOUT, session.close()).await {
        Ok(Ok(())) => {}
        Ok(Err(error)) => tracing::warn!("closing the Zenoh session failed: {error}"),
        Err(_) => tracing::warn!("closing the Zenoh session took longer than {CLOSE_TIMEOUT:?}, left it"),
    }
}
