//! Why a query has no answer.

use protocol::{CodecError, ErrorCode, ErrorReply};

/// Why a query has no answer, or a subscription was not declared.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ClientError {
    /// The query cannot be encoded.
    #[error("the query cannot be sent: {0}")]
    Encode(#[source] CodecError),
    /// Zenoh did not accept the query.
    #[error("the query could not be sent: {problem}")]
    Send {
        /// Error of Zenoh or of the runtime.
        problem: String,
    },
    /// The query was not sent before the deadline.
    #[error("the link is congested: the query was not sent before the deadline")]
    Congested,
    /// No queryable answered.
    #[error("no map server answers; is it running and serving this map?")]
    NoServer,
    /// The deadline passed while waiting for a reply.
    #[error("no answer before the deadline")]
    Deadline,
    /// The replies ended without the final status.
    #[error("the map server stopped in the middle of its answer")]
    Interrupted,
    /// Fewer keyframes were received than were sent.
    #[error("{received} of {sent} keyframes arrived")]
    KeyframesMissing {
        /// Keyframes received.
        received: usize,
        /// Keyframes sent, as the final status states.
        sent: usize,
    },
    /// The answer does not end.
    #[error(
        "the answer does not end: {replies} replies of {bytes} bytes; is another program answering for the map server?"
    )]
    TooLong {
        /// Replies read.
        replies: usize,
        /// Their bytes.
        bytes: usize,
    },
    /// Zenoh reported an error in place of a reply, for example "Timeout" if the server hangs.
    #[error("no answer: {problem}")]
    Transport {
        /// Text of the error.
        problem: String,
    },
    /// The server refused the query.
    #[error("{}", .0.message)]
    Refused(ErrorReply),
    /// A reply cannot be decoded.
    #[error("the map server's answer is unreadable: {0}")]
    Unreadable(#[source] CodecError),
    /// A session file arrives damaged, again and again.
    #[error("the session was sent {attempts} times and arrived damaged each time")]
    Damaged {
        /// How often it was sent.
        attempts: usize,
    },
    /// The background task of the query panicked.
    #[error("the query ended badly: {problem}")]
    TaskFailed {
        /// Text of the panic.
        problem: String,
    },
    /// The subscription to the changes of a map was not declared.
    #[error("cannot subscribe to the changes of map {map}: {problem}")]
    Subscribe {
        /// Name of the map.
        map: String,
        /// Error of Zenoh.
        problem: String,
    },
}

impl ClientError {
    /// Whether the same query may be answered when it is sent again.
    ///
    /// ```
    /// use client::ClientError;
    /// use protocol::{ErrorCode, ErrorReply};
    /// assert!(ClientError::NoServer.is_transient());
    /// assert!(ClientError::Refused(ErrorReply::new(ErrorCode::Busy, "ask again later")).is_transient());
    /// assert!(!ClientError::Refused(ErrorReply::new(ErrorCode::UnknownMap, "no such map")).is_transient());
    /// ```
    pub fn is_transient(&self) -> bool {
        match self {
            Self::Send { .. }
            | Self::Congested
            | Self::NoServer
            | Self::Deadline
            | Self::Interrupted
            | Self::KeyframesMissing { .. }
            | Self::Transport { .. } => true,
            Self::Refused(reply) => reply.code == ErrorCode::Busy,
            Self::Encode(_)
            | Self::Unreadable(_)
            | Self::TooLong { .. }
            | Self::Damaged { .. }
            | Self::TaskFailed { .. }
            | Self::Subscribe { .. } => false,
        }
    }

    /// Whether the server refused because it does not serve the map.
    pub fn is_unknown_map(&self) -> bool {
        matches!(self, Self::Refused(reply) if reply.code == ErrorCode::UnknownMap)
    }
}
