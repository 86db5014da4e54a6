//! Errors of fleets.

use client::session::SessionError;
use protocol::keys::NameError;
use std::path::PathBuf;

/// Why a fleet was not written, read or changed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FleetError {
    /// Something is there already.
    #[error("{path} exists already and is not overwritten; `driftless fleet renew` makes new certificates")]
    Exists {
        /// What is there.
        path: PathBuf,
    },
    /// A file or folder cannot be read or written.
    #[error("{path}: {problem}")]
    File {
        /// The file.
        path: PathBuf,
        /// Error of the system.
        problem: std::io::Error,
    },
    /// There is no fleet in the folder.
    #[error("{path} describes no fleet ({problem}); `driftless fleet init` writes one")]
    NoFleet {
        /// The file that describes it.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
    },
    /// A name cannot be part of a key.
    #[error(transparent)]
    Name(#[from] NameError),
    /// The namespace cannot be used.
    #[error(transparent)]
    Namespace(#[from] SessionError),
    /// A name has another meaning in the folder of the fleet.
    #[error("no member can have the name {name:?}: give another one")]
    ReservedName {
        /// The name.
        name: String,
    },
    /// Two members of one name.
    #[error(
        "the fleet has a member {name:?} already: give each robot, server and operator a name of its own"
    )]
    TwoOfOneName {
        /// The name.
        name: String,
    },
    /// Nobody has this name.
    #[error("the fleet has no member {name:?}")]
    UnknownMember {
        /// The name.
        name: String,
    },
    /// There is no server.
    #[error("a fleet needs a map server: give --servers NAME")]
    NoServer,
    /// Two servers have nothing to meet at.
    #[error(
        "this fleet has no router, and its robots connect to its only server: make it anew with --router for several"
    )]
    NoRouter,
    /// The address is none.
    #[error("{address:?} is no address: give a name or an IP address without port, for example 10.0.0.1")]
    Address {
        /// As given.
        address: String,
    },
    /// A certificate or key could not be made or read.
    #[error("certificates: {0}")]
    Certificate(#[from] rcgen::Error),
}
