//! Errors of the publisher.

use protocol::keys;

/// Why a robot cannot publish.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PublisherError {
    /// The robot's name cannot be part of a key expression.
    #[error(transparent)]
    Name(#[from] keys::NameError),
    /// The liveliness token could not be declared.
    #[error("the liveliness token of the robot cannot be declared: {0}")]
    Liveliness(zenoh::Error),
}
