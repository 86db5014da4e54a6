//! Takes sessions that robots hand in.

use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;

use hand_in::{Inbox, InboxError};
use protocol::{ErrorCode, ErrorReply, MAX_SESSION_PART_BYTES, SessionPart, SessionPartReply, keys};
use zenoh::Session;
use zenoh::query::{Query, Queryable};

use crate::error::ServeError;
use crate::handlers;

/// Parts that may wait for the disk; any more are answered with `Busy`.
const QUEUE: usize = 64;
/// Largest payload that is looked at: a part as numbers in JSON, four characters a byte.
const MOST_PAYLOAD: usize = 5 * MAX_SESSION_PART_BYTES;

/// Takes sessions of some maps into an [`Inbox`], on a thread of its own.
///
/// One server of a map takes them: a robot goes on where the server that answers has its file.
pub struct InboxService {
    queryables: Vec<Queryable<()>>,
    thread: JoinHandle<()>,
}

impl InboxService {
    /// Declares `map/{map}/sessions/*` for each map, and starts the thread.
    ///
    /// # Errors
    /// [`ServeError::Name`], [`ServeError::Threads`], [`ServeError::Zenoh`]; nothing remains declared.
    pub async fn start(
        session: &Session,
        maps: impl IntoIterator<Item = &str>,
        inbox: Inbox,
    ) -> Result<Self, ServeError> {
        let (sender, parts) = sync_channel(QUEUE);
        let thread = std::thread::Builder::new().name("inbox".into());
        let thread = thread.spawn(move || take_all(inbox, &parts)).map_err(ServeError::Threads)?;
        let mut queryables = Vec::new();
        for map in maps {
            let key = keys::map_sessions(map, None)?;
            let sender = sender.clone();
            let callback = move |query: Query| put(&sender, query);
            queryables.push(session.declare_queryable(key).callback(callback).complete(true).await?);
        }
        Ok(Self { queryables, thread })
    }

    /// Takes no more parts, and waits for those that have come.
    ///
    /// # Errors
    /// [`ServeError::Zenoh`] if something could not be undeclared.
    pub async fn stop(self) -> Result<(), ServeError> {
        for queryable in self.queryables {
            queryable.undeclare().await?;
        }
        let _ = tokio::task::spawn_blocking(move || self.thread.join()).await;
        Ok(())
    }
}

fn put(sender: &SyncSender<Query>, query: Query) {
    if query.payload().is_some_and(|payload| payload.len() > MOST_PAYLOAD) {
        let message = format!("a part of a session has at most {MAX_SESSION_PART_BYTES} bytes");
        return handlers::fail(&query, &ErrorReply::new(ErrorCode::BadRequest, message));
    }
    if let Err(TrySendError::Full(query)) = sender.try_send(query) {
        let message = "too many sessions are being handed in: send this part again later";
        handlers::fail(&query, &ErrorReply::new(ErrorCode::Busy, message));
    }
}

fn take_all(mut inbox: Inbox, parts: &Receiver<Query>) {
    while let Ok(query) = parts.recv() {
        if let Err(error) = take(&mut inbox, &query) {
            handlers::fail(&query, &error);
        }
    }
}

fn take(inbox: &mut Inbox, query: &Query) -> Result<(), ErrorReply> {
    let format = handlers::reply_format(query).map_err(|error| ErrorReply::from(&error))?;
    let part: SessionPart = handlers::decode(query)?;
    let key = query.key_expr().as_str().to_owned();
    let robot = key.rsplit('/').next().unwrap_or_default();
    let received = inbox.take(robot, &part).map_err(|error| refusal(robot, &error))?;
    if received.is_complete && !part.bytes.is_empty() {
        tracing::info!(robot, bytes = part.total_bytes, "a session was handed in");
    }
    let reply = SessionPartReply { received_bytes: received.bytes, is_complete: received.is_complete };
    handlers::send(query, &key, format, &reply).map(|_| ())
}

fn refusal(robot: &str, error: &InboxError) -> ErrorReply {
    tracing::warn!(robot, %error, "a session is not taken");
    let code = match error {
        InboxError::Io { .. } => ErrorCode::Internal,
        _ => ErrorCode::BadRequest,
    };
    ErrorReply::new(code, error.to_string())
}
