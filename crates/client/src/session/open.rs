//! Opening and closing a session.

use super::error::SessionError;
use super::{RETRY_MS, SessionMode, SessionOptions, checks};
use std::time::{Duration, Instant};
use tracing::subscriber::{NoSubscriber, with_default};
use zenoh::Wait as _;

/// How long closing a session may take.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(5);
/// The reason of a failed connection is logged at the first attempt, and again after this time.
const REPEAT: Duration = Duration::from_secs(30);
/// How Zenoh's error begins where nobody answered, which may change; all else is a fault of the configuration.
const UNREACHABLE: &str = "Unable to connect";

/// Opens a session, and logs what it is in the network.
///
/// A client is open when it is connected, and waits for that as long as it takes: drop the future to give up; an attempt
/// under way ends by itself within 4 s per endpoint. A peer or router is open as soon as it listens; connecting continues
/// in the background. Connections that are lost are made again.
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
    let opened = if mode == SessionMode::Client.name() {
        open_client(&config, &connect).await
    } else {
        attempt(config, true).await
    };
    opened.map_err(|problem| SessionError::Open { listen, problem: problem.to_string() })
}

/// Tries until somebody answers.
async fn open_client(config: &zenoh::Config, connect: &[String]) -> zenoh::Result<zenoh::Session> {
    let (mut pause_ms, longest_ms) = RETRY_MS;
    let mut told: Option<Instant> = None;
    loop {
        let tell = told.is_none_or(|at| at.elapsed() >= REPEAT);
        match attempt(config.clone(), tell).await {
            Ok(session) => {
                tracing::info!(connect = connect.join(", "), "connected");
                return Ok(session);
            }
            Err(problem) if !problem.to_string().starts_with(UNREACHABLE) => return Err(problem),
            Err(_) if tell => {
                tracing::warn!(
                    connect = connect.join(", "),
                    "not connected yet, trying until somebody answers"
                );
                told = Some(Instant::now());
            }
            Err(_) => {}
        }
        tokio::time::sleep(Duration::from_millis(pause_ms)).await;
        pause_ms = (2 * pause_ms).min(longest_ms);
    }
}

/// Opens a session, on a thread of its own: Zenoh blocks the one that it is called on.
///
/// # Arguments
/// * `tell`: whether Zenoh logs why it does not connect, which its error does not say.
async fn attempt(config: zenoh::Config, tell: bool) -> zenoh::Result<zenoh::Session> {
    let open = move || zenoh::open(config).wait();
    let quietly = move || if tell { open() } else { with_default(NoSubscriber::new(), open) };
    tokio::task::spawn_blocking(quietly).await?
}

/// Closes a session; returns after 5 s at the latest, if the other side does not respond.
pub async fn close_session(session: &zenoh::Session) {
    match tokio::time::timeout(CLOSE_TIMEOUT, session.close()).await {
        Ok(Ok(())) => {}
        Ok(Err(error)) => tracing::warn!("closing the Zenoh session failed: {error}"),
        Err(_) => tracing::warn!("closing the Zenoh session took longer than {CLOSE_TIMEOUT:?}, left it"),
    }
}
