//! Why a session was not opened.

use super::endpoint::EndpointError;
use std::path::PathBuf;

/// Why a session was not opened.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SessionError {
    /// The configuration file cannot be used.
    #[error("the Zenoh configuration {path} cannot be used: {problem}")]
    ConfigFile {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
    },
    /// The configuration asks for what this build of Zenoh does not have.
    #[error("the Zenoh configuration {path} asks for {key} = {value}, and {why}")]
    NotInThisBuild {
        /// The file.
        path: PathBuf,
        /// The key in it.
        key: String,
        /// Its value.
        value: String,
        /// What is missing, and what to do.
        why: &'static str,
    },
    /// A file that the configuration names is not there.
    #[error("{key} of the Zenoh configuration names {file}, which cannot be read: {problem}")]
    MissingFile {
        /// The key.
        key: &'static str,
        /// The file.
        file: PathBuf,
        /// Error of the system.
        problem: std::io::Error,
    },
    /// The folder is not one that `driftless fleet` writes.
    #[error(
        "--secure {folder} is no member's folder of a fleet: {problem}; `driftless fleet init` writes them"
    )]
    NoMember {
        /// The folder.
        folder: PathBuf,
        /// What is wrong with it.
        problem: String,
    },
    /// The folder belongs to a member of another role.
    #[error("--secure {folder} belongs to {role} {name}; this program needs the folder of a {wanted}")]
    OtherRole {
        /// The folder.
        folder: PathBuf,
        /// Role of the member.
        role: &'static str,
        /// Name of the member.
        name: String,
        /// Role that the program has.
        wanted: &'static str,
    },
    /// The program was given another name than its certificate.
    #[error("{switch} {given} does not fit --secure {folder}, the folder of {name}: leave {switch} out")]
    OtherName {
        /// The switch.
        switch: &'static str,
        /// Its value.
        given: String,
        /// The folder.
        folder: PathBuf,
        /// Name of the member.
        name: String,
    },
    /// An endpoint without encryption in a secured fleet.
    #[error("{endpoint} is not encrypted, and --secure is given: write tls/...")]
    NotEncrypted {
        /// The endpoint.
        endpoint: String,
    },
    /// An option has an invalid value.
    #[error("{what} {value:?} cannot be used: {problem}")]
    Value {
        /// The option.
        what: &'static str,
        /// Its value.
        value: String,
        /// Error of Zenoh.
        problem: String,
    },
    /// An endpoint cannot be used.
    #[error(transparent)]
    Endpoint(#[from] EndpointError),
    /// A client without anybody to connect to.
    #[error("a session of mode client needs an endpoint to connect to: give --connect")]
    ClientOfNobody,
    /// Zenoh did not open the session.
    #[error("the Zenoh session did not open{}: {problem}{}", listening(listen), port_taken(listen))]
    Open {
        /// Endpoints to listen on.
        listen: Vec<String>,
        /// Error of Zenoh.
        problem: String,
    },
}

/// The endpoints that a session was to listen on.
fn listening(listen: &[String]) -> String {
    if listen.is_empty() { String::new() } else { format!(" (listening on {})", listen.join(", ")) }
}

/// What may hold a port, and what to do.
fn port_taken(listen: &[String]) -> &'static str {
    if listen.iter().any(|endpoint| endpoint.ends_with(":7447")) {
        "; is port 7447 taken? rmw_zenohd and zenohd listen on it, too: stop it, give another port with --listen \
         tcp/0.0.0.0:7448, or use that router with --connect tcp/localhost:7447 in place of --listen"
    } else if listen.is_empty() {
        ""
    } else {
        "; is the port taken already? Give another one"
    }
}
