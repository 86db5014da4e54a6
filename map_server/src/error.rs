//! Why a server does not start, or a map is not replaced.

use protocol::keys::NameError;
use protocol::{CodecError, MapIdentity};

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
    /// The version is not newer than the one that is served.
    #[error(
        "version {given} of map {name} is not newer than version {served}, which is served: make it the next version \
         (import-map --force), or restart the server"
    )]
    OldVersion {
        /// Name of the map.
        name: String,
        /// Version that is served.
        served: u64,
        /// Version that was to replace it.
        given: u64,
    },
    /// What is to be served is no version of the map that is served.
    #[error(
        "map {name} is {served}, and {given} is another map: robots would take the poses in one for poses in the other; \
         write it over the served one to make it its next version (--force), or serve it under another name, or restart the \
         server and the robots"
    )]
    OtherMap {
        /// The name under which the map is served.
        name: String,
        /// Identity of the served map.
        served: MapIdentity,
        /// Identity of the other one.
        given: MapIdentity,
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
