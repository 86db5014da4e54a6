//! Decodes a query, answers it, encodes the reply.

use std::collections::BTreeSet;
use std::time::Instant;

use protocol::{
    CellLocalizeReply, CellMatchReply, CellPlace, ErrorCode, ErrorReply, Format, KeyframeId, LocalizeRequest,
    MatchOutcome, MatchReply, MatchRequest, Message, keys,
};
use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::query::Query;

use crate::kind::{Kind, Subject};
use crate::reports::{AnsweredQuery, ReportSender, position_of};
use recognition::{LoadedMap, QueryError, RecognitionOptions, SearchReport};

/// Keyframes that one turn of a query for all of them sends: such a query must not keep a worker from the others.
const KEYFRAMES_A_TURN: usize = 16;

/// How far the answer to a query is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Progress {
    /// Everything was sent.
    Done,
    /// The first keyframes of the map were sent, the last turn's with so many bytes.
    Keyframes { sent: usize, bytes: usize },
}

/// A query in the hands of a worker.
pub(crate) struct ReceivedQuery {
    pub(crate) query: Query,
    pub(crate) subject: Subject,
    /// Of the map.
    pub(crate) name: String,
    pub(crate) received: Instant,
    /// Keyframes that former turns sent.
    pub(crate) sent: usize,
}

/// Answers a query, or goes on after the keyframes that were sent. An error is returned, not yet sent.
pub(crate) fn answer(
    asked: &ReceivedQuery,
    map: &LoadedMap,
    options: &RecognitionOptions,
    reports: &ReportSender,
) -> Result<Progress, ErrorReply> {
    let ReceivedQuery { query, subject, name, received, sent } = asked;
    let (kind, cell) = (subject.kind(), subject.cell());
    let format = reply_format(query).map_err(|error| ErrorReply::from(&error))?;
    let key = || subject.key(name).map_err(|error| internal(&error));
    match kind {
        Kind::Match => {
            let request: MatchRequest = decode(query)?;
            let (replies, search) =
                map.answer_with_report(&request, options).map_err(|error| query_error(name, &error))?;
            let key = key()?;
            let answer = CellMatchReply { replies, place: place_of(&search) };
            if cell.is_some() {
                send(query, &key, format, &answer)?;
            } else {
                for reply in &answer.replies {
                    send(query, &key, format, reply)?;
                }
            }
            let answered = || {
                let (outcome, keyframes) = outcome_of(&answer.replies);
                Ok(AnsweredQuery {
                    outcome,
                    keyframes,
                    map_version: map.info().version,
                    stamp_ns: Some(request.stamp_ns),
                    features: request.features.len(),
                    prior_in_global: position_of(request.prior.as_ref()),
                    fix: None,
                    search,
                })
            };
            reports.note(query, kind, name, *received, answered);
        }
        Kind::Localize => {
            let request: LocalizeRequest = decode(query)?;
            let (reply, search) =
                map.localize_with_report(&request, options).map_err(|error| query_error(name, &error))?;
            let answer = CellLocalizeReply { reply, place: place_of(&search) };
            let reply = &answer.reply;
            if cell.is_some() {
                send(query, &key()?, format, &answer)?;
            } else {
                send(query, &key()?, format, reply)?;
            }
            let answered = || {
                Ok(AnsweredQuery {
                    outcome: reply.outcome,
                    keyframes: reply.fix.iter().map(|fix| fix.keyframe).collect(),
                    map_version: reply.map_version,
                    stamp_ns: None,
                    features: request.features.len(),
                    prior_in_global: position_of(request.prior.as_ref()),
                    fix: reply.fix.clone(),
                    search,
                })
            };
            reports.note(query, kind, name, *received, answered);
        }
        Kind::Info => {
            send(query, &key()?, format, &map.info_reply(name))?;
        }
        Kind::Keyframes => return send_keyframes(asked, map, *sent, format),
    }
    Ok(Progress::Done)
}

/// The outcome and the keyframes of an answer.
fn outcome_of(replies: &[MatchReply]) -> (MatchOutcome, Vec<KeyframeId>) {
    let mut outcome = MatchOutcome::NoMatch;
    let mut keyframes = Vec::new();
    for reply in replies {
        match reply {
            MatchReply::Keyframe(matched) => keyframes.push(matched.keyframe.id),
            MatchReply::Done(status) => outcome = status.outcome,
        }
    }
    (outcome, keyframes)
}

/// The place that a search found.
fn place_of(search: &SearchReport) -> Option<CellPlace> {
    search.place.as_ref().map(|place| CellPlace {
        global_from_camera: place.global_from_camera,
        features: place.features as u32,
    })
}

/// Sends one keyframe, or those of one turn for a wildcard in the key.
fn send_keyframes(
    asked: &ReceivedQuery,
    map: &LoadedMap,
    sent: usize,
    format: Format,
) -> Result<Progress, ErrorReply> {
    let ReceivedQuery { query, name, subject, .. } = asked;
    let key_of = |id: KeyframeId| {
        let key = subject
            .cell()
            .map_or_else(|| keys::map_keyframe(name, id), |cell| keys::cell_keyframe(name, cell, Some(id)));
        key.map_err(|error| internal(&error))
    };
    if let Some(id) = asked_keyframe(query)? {
        let reply = map.keyframe_reply(id).ok_or_else(|| unknown_keyframe(name, id))?;
        send(query, &key_of(id)?, format, &reply)?;
        return Ok(Progress::Done);
    }
    let mut bytes = 0;
    for keyframe in map.keyframes().skip(sent).take(KEYFRAMES_A_TURN) {
        let id = keyframe.id;
        if let Some(reply) = map.keyframe_reply(id) {
            bytes += send(query, &key_of(id)?, format, &reply)?;
        }
    }
    let sent = sent + KEYFRAMES_A_TURN;
    Ok(if sent < map.keyframe_count() { Progress::Keyframes { sent, bytes } } else { Progress::Done })
}

/// The keyframe that is asked for; `None` for all of them.
pub(crate) fn asked_keyframe(query: &Query) -> Result<Option<KeyframeId>, ErrorReply> {
    let asked = query.key_expr().as_str();
    let id = keys::keyframe_of(asked);
    if id.is_none() && !asked.ends_with('*') {
        let message = format!("{asked} does not end with the id of a keyframe (a whole number), or with *");
        return Err(ErrorReply::new(ErrorCode::BadRequest, message));
    }
    Ok(id)
}

pub(crate) fn unknown_keyframe(name: &str, id: KeyframeId) -> ErrorReply {
    ErrorReply::new(ErrorCode::UnknownKeyframe, format!("map {name} has no keyframe {id}"))
}

/// Refuses a query about a map that this server does not have. Queries about its own maps, and about several maps at
/// once, are answered by the queryables of the maps.
pub(crate) fn refuse_unknown_map(query: &Query, known: &BTreeSet<String>) {
    let Some(name) = query.key_expr().as_str().split('/').nth(1) else { return };
    if known.contains(name) || keys::validate_name(name).is_err() {
        return;
    }
    let served = match known.len() {
        0 => "no map".to_owned(),
        _ => known.iter().map(String::as_str).collect::<Vec<_>>().join(", "),
    };
    let message = format!("there is no map named {name}; this server has {served}");
    fail(query, &ErrorReply::new(ErrorCode::UnknownMap, message));
}

/// Sends an error reply in the format of the query.
pub(crate) fn fail(query: &Query, error: &ErrorReply) {
    let format = reply_format(query).unwrap_or_default();
    match protocol::encode(format, error) {
        Ok(payload) => {
            if let Err(problem) = query.reply_err(payload).encoding(Encoding::from(format.encoding())).wait()
            {
                tracing::debug!("an error reply was not sent: {problem}");
            }
        }
        Err(problem) => tracing::error!("the error reply {error} cannot be encoded: {problem}"),
    }
}

/// Sends a reply.
///
/// # Returns
/// Its bytes.
pub(crate) fn send<M: Message>(
    query: &Query,
    key: &str,
    format: Format,
    message: &M,
) -> Result<usize, ErrorReply> {
    let payload = protocol::encode(format, message).map_err(|error| internal(&error))?;
    let bytes = payload.len();
    let reply = query.reply(key, payload).encoding(Encoding::from(format.encoding()));
    reply.wait().map_err(|error| internal(&error))?;
    Ok(bytes)
}

/// The requested format of the reply: the query's parameter, else the format of its payload.
pub(crate) fn reply_format(query: &Query) -> Result<Format, protocol::CodecError> {
    let parameters = query.parameters();
    if parameters.get("format").is_some() {
        return Format::from_parameters(parameters.as_str());
    }
    let payload = query.payload().map(zenoh::bytes::ZBytes::to_bytes);
    Ok(payload.map_or_else(Format::default, |bytes| payload_format(query, &bytes)))
}

/// The format of the payload: its encoding, else guessed from its first byte.
fn payload_format(query: &Query, bytes: &[u8]) -> Format {
    let stated = query.encoding().and_then(|encoding| Format::from_encoding(&encoding.to_string()));
    let is_object = || bytes.trim_ascii_start().starts_with(b"{");
    stated.unwrap_or_else(|| if is_object() { Format::Json } else { Format::Bincode })
}

pub(crate) fn decode<M: Message>(query: &Query) -> Result<M, ErrorReply> {
    let Some(payload) = query.payload().filter(|payload| !payload.is_empty()) else {
        let message = format!("the query has no payload: send a {}", M::NAME);
        return Err(ErrorReply::new(ErrorCode::BadRequest, message));
    };
    let bytes = payload.to_bytes();
    protocol::decode(payload_format(query, &bytes), &bytes).map_err(|error| ErrorReply::from(&error))
}

pub(crate) fn query_error(map: &str, error: &QueryError) -> ErrorReply {
    let code = match error {
        QueryError::DescriptorMismatch { .. } | QueryError::ExtractorMismatch { .. } => {
            ErrorCode::DescriptorMismatch
        }
        QueryError::Descriptors(_) => ErrorCode::BadRequest,
    };
    ErrorReply::new(code, format!("map {map}: {error}"))
}

pub(crate) fn internal(error: &dyn std::fmt::Display) -> ErrorReply {
    ErrorReply::new(ErrorCode::Internal, format!("the map server failed: {error}"))
}
