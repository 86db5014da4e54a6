//! Why the map cannot be shown.

use std::net::SocketAddr;

/// Why the map cannot be shown.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ViewerError {
    /// The address cannot be listened on.
    #[error("the map cannot be shown on http://{address}: {source}; is the port taken already?")]
    Bind {
        /// The address.
        address: SocketAddr,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The topics of robots cannot be subscribed to.
    #[error("robots cannot be followed: {0}")]
    Zenoh(zenoh::Error),
}
