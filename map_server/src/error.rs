//! Why a server does not start, or a map is not replaced.

use protocol::CodecError;
use protocol::keys::NameError;

/// Why a server does not start, or a map is not replaced.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ServeError {
    /// A name cannot be part of a key.
    #[error(transparent)]
    Name(#[from] NameError),
    /// Two maps have the same name.
    #[error("two maps are to be served as {name:?}: give each its own name")]
    DuplicateMap {
        /// The name.
        name: String,
    },
    /// The server has no map of that name.
    #[error("no map named {name:?} is served here")]
    UnknownMap {
        /// The name.
        name: String,
    },
    /// A message cannot be encoded.
    #[error(transparent)]
    Codec(#[from] CodecError),
    /// Zenoh reported an error.
    #[error("Zenoh: {0}")]
    Zenoh(zenoh::Error),
}

impl From<zenoh::Error> for ServeError {
    fn from(error: zenoh::Error) -> ServeError {
        ServeError::Zenoh(error)
    }
}
