//! Errors of a node.

use super::names::NameError;
use ros_messages::CdrError;

/// Why a node, publisher or subscriber cannot do its work.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RosError {
    /// A name that ROS does not allow.
    #[error(transparent)]
    Name(#[from] NameError),
    /// A message that cannot be written.
    #[error(transparent)]
    Cdr(#[from] CdrError),
    /// Zenoh refused: the session is closed, or may not use the key.
    #[error("{what}: {source}")]
    Zenoh {
        /// What was to be done.
        what: &'static str,
        /// What Zenoh says.
        source: zenoh::Error,
    },
}

impl RosError {
    /// Puts what was to be done before Zenoh's error.
    pub(crate) fn zenoh(what: &'static str) -> impl FnOnce(zenoh::Error) -> Self {
        move |source| Self::Zenoh { what, source }
    }
}
