//! Why a query was not answered, sent as Zenoh's error reply.
//!
//! "Nothing matched" is an answer, not an error: see [`crate::MatchOutcome`].

use crate::codec::CodecError;
use crate::limits::MAX_TEXT_BYTES;
use crate::validate::{InvalidField, Validate, require_short};
use serde::{Deserialize, Serialize};

/// Kind of failure, for programs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[non_exhaustive]
#[serde(rename_all = "snake_case")]
pub enum ErrorCode {
    /// The payload cannot be decoded, or a field is invalid. Sending the same bytes again is useless.
    BadRequest,
    /// The payload is of another schema version: update the older side.
    SchemaMismatch,
    /// The query's descriptors differ from the map's in kind, width or extractor.
    DescriptorMismatch,
    /// The server has no such map.
    UnknownMap,
    /// The map has no such keyframe.
    UnknownKeyframe,
    /// The server has too many queries: ask again later.
    Busy,
    /// A fault of the server.
    Internal,
}

/// A query that could not be answered.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ErrorReply {
    /// Kind of failure.
    pub code: ErrorCode,
    /// What happened, to what, and what to do; human-readable.
    pub message: String,
}

impl ErrorReply {
    /// An error reply; an overlong message is cut at [`MAX_TEXT_BYTES`].
    pub fn new(code: ErrorCode, message: impl Into<String>) -> Self {
        let mut message = message.into();
        message.truncate(message.floor_char_boundary(MAX_TEXT_BYTES));
        Self { code, message }
    }
}

/// The reply to a payload that did not decode.
impl From<&CodecError> for ErrorReply {
    fn from(error: &CodecError) -> Self {
        let code = match error {
            CodecError::SchemaMismatch { .. } => ErrorCode::SchemaMismatch,
            _ => ErrorCode::BadRequest,
        };
        Self::new(code, error.to_string())
    }
}

impl std::fmt::Display for ErrorReply {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str(&self.message)
    }
}

impl Validate for ErrorReply {
    fn validate(&self) -> Result<(), InvalidField> {
        require_short(&self.message, "message")
    }
}
