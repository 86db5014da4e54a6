//! Asynchronous queries to one map.

use crate::error::ClientError;
use crate::request::{Collector, Request, Retry, SingleReply, Traffic};
use protocol::keys::{self, NameError};
use protocol::{
    KeyframeId, KeyframeReply, LocalizeReply, LocalizeRequest, MapInfoReply, MatchOutcome, MatchReply,
    MatchRequest, MatchStatus, MatchedKeyframe,
};
use std::time::Instant;

/// The complete answer to a [`MatchRequest`].
#[derive(Clone, Debug, PartialEq)]
pub struct MatchAnswer {
    /// Result of the search. Keyframes are present only if its outcome is [`MatchOutcome::Matched`].
    pub status: MatchStatus,
    /// The matched keyframes in the order of their arrival, all of those that the server sent.
    pub keyframes: Vec<MatchedKeyframe>,
}

/// Queries to one map over an open Zenoh session.
///
/// Every method returns at the latest shortly after its `deadline`, and repeats the query until then as described in
/// the [crate documentation](crate#retries). Needs a multi-threaded tokio runtime. Cloning is cheap.
#[derive(Clone, Debug)]
pub struct MapClient {
    session: zenoh::Session,
    map: String,
    retry: Retry,
}

impl MapClient {
    /// A client for the map that is served as `map`.
    ///
    /// # Errors
    /// [`NameError`] for a name that cannot be part of a key.
    pub fn new(session: zenoh::Session, map: &str) -> Result<Self, NameError> {
        keys::validate_name(map)?;
        Ok(Self { session, map: map.to_owned(), retry: Retry::Transient })
    }

    /// The same client, which also repeats a query while the answer is that the map is unknown.
    ///
    /// For a session that was just opened in a network with several servers: another server may be connected before the
    /// one that serves the map.
    #[must_use]
    pub fn awaiting_map(self) -> Self {
        Self { retry: Retry::TransientOrUnknownMap, ..self }
    }

    /// The session that it uses.
    pub(crate) fn session(&self) -> &zenoh::Session {
        &self.session
    }

    /// Name of the map.
    pub fn map(&self) -> &str {
        &self.map
    }

    /// Asks which keyframes an image matches.
    ///
    /// # Errors
    /// [`ClientError`]; of the last attempt, if several were made.
    pub async fn match_image(
        &self,
        request: &MatchRequest,
        deadline: Instant,
    ) -> Result<MatchAnswer, ClientError> {
        self.match_image_counted(request, deadline, self.retry, &mut Traffic::default()).await
    }

    /// Asks where an image was taken.
    ///
    /// # Errors
    /// [`ClientError`]; of the last attempt, if several were made.
    pub async fn localize(
        &self,
        request: &LocalizeRequest,
        deadline: Instant,
    ) -> Result<LocalizeReply, ClientError> {
        let request = self.request(keys::map_localize(&self.map), deadline)?.with_payload(request)?;
        request.send::<SingleReply<LocalizeReply>>(self.retry, &mut Traffic::default()).await
    }

    /// Asks for the properties of the map.
    ///
    /// # Errors
    /// [`ClientError`]; of the last attempt, if several were made.
    pub async fn info(&self, deadline: Instant) -> Result<MapInfoReply, ClientError> {
        let request = self.request(keys::map_info(&self.map), deadline)?;
        request.send::<SingleReply<MapInfoReply>>(self.retry, &mut Traffic::default()).await
    }

    /// Asks for one keyframe with its landmarks.
    ///
    /// # Errors
    /// [`ClientError`], of the last attempt, if several were made; [`ClientError::Refused`] with
    /// [`protocol::ErrorCode::UnknownKeyframe`] if the map has no such keyframe.
    pub async fn keyframe(&self, id: KeyframeId, deadline: Instant) -> Result<KeyframeReply, ClientError> {
        let request = self.request(keys::map_keyframe(&self.map, id), deadline)?;
        request.send::<SingleReply<KeyframeReply>>(self.retry, &mut Traffic::default()).await
    }

    /// [`MapClient::match_image`] with its own retry rule, counting payload bytes.
    pub(crate) async fn match_image_counted(
        &self,
        request: &MatchRequest,
        deadline: Instant,
        retry: Retry,
        traffic: &mut Traffic,
    ) -> Result<MatchAnswer, ClientError> {
        let request = self.request(keys::map_match(&self.map), deadline)?.with_payload(request)?;
        request.send::<MatchCollector>(retry, traffic).await
    }

    fn request(&self, key: Result<String, NameError>, deadline: Instant) -> Result<Request, ClientError> {
        let key = key.map_err(|error| ClientError::Send { problem: error.to_string() })?;
        Ok(Request::new(&self.session, key, deadline))
    }
}

/// Keyframes until the final status.
#[derive(Default)]
struct MatchCollector {
    keyframes: Vec<MatchedKeyframe>,
}

impl Collector for MatchCollector {
    type Reply = MatchReply;
    type Answer = MatchAnswer;

    fn add(&mut self, reply: MatchReply) -> Option<Result<MatchAnswer, ClientError>> {
        let status = match reply {
            MatchReply::Keyframe(keyframe) => {
                self.keyframes.push(keyframe);
                return None;
            }
            MatchReply::Done(status) => status,
        };
        let keyframes = std::mem::take(&mut self.keyframes);
        let (received, sent) = (keyframes.len(), usize::from(status.keyframes_sent));
        if status.outcome == MatchOutcome::Matched && received != sent {
            return Some(Err(ClientError::KeyframesMissing { received, sent }));
        }
        Some(Ok(MatchAnswer { status, keyframes }))
    }
}
