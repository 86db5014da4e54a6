//! Switches of a session, the same for every program.

use crate::session::{DEFAULT_ENDPOINT, SessionMode, SessionOptions};
use std::path::PathBuf;

/// What a server listens on where it is to be found by multicast.
const ANY_INTERFACE: &str = "tcp/0.0.0.0:7447";

/// Switches of a session.
#[derive(Clone, Debug, Default, clap::Args)]
#[command(next_help_heading = "Network")]
pub struct SessionArguments {
    /// Endpoint of a map server or of a Zenoh router, for example tcp/10.0.0.1:7447; retried until it answers. May be
    /// given several times.
    #[arg(long, value_name = "ENDPOINT")]
    pub connect: Vec<String>,
    /// Endpoint to listen on, for example tcp/0.0.0.0:7447 for the whole network. May be given several times.
    #[arg(long, value_name = "ENDPOINT")]
    pub listen: Vec<String>,
    /// Find routers and peers of the local network by multicast
    #[arg(long)]
    pub scout: bool,
    /// Folder of this member of a secured fleet, written by `driftless fleet init`
    #[arg(long, value_name = "DIR", conflicts_with = "zenoh_config")]
    pub secure: Option<PathBuf>,
    /// Zenoh configuration file (JSON5), for TLS, users and access control; the other switches override it
    #[arg(long, value_name = "FILE")]
    pub zenoh_config: Option<PathBuf>,
    /// Prefix of all keys; one namespace per fleet
    #[arg(long, value_name = "NAME")]
    pub namespace: Option<String>,
    /// Mode of the session [default: client with one --connect, peer without, router with several or with --listen]
    #[arg(long, value_enum, value_name = "MODE")]
    pub session_mode: Option<SessionMode>,
}

impl SessionArguments {
    /// The options of a program that others connect to: listens on [`DEFAULT_ENDPOINT`] by default.
    pub fn serving(&self) -> SessionOptions {
        let mut options = self.options();
        if self.says_nothing() {
            options.listen.push(if self.scout { ANY_INTERFACE } else { DEFAULT_ENDPOINT }.to_owned());
        }
        options
    }

    /// The options of a program that connects to others: connects to [`DEFAULT_ENDPOINT`] by default.
    pub fn connecting(&self) -> SessionOptions {
        let mut options = self.options();
        if self.says_nothing() && !self.scout {
            options.connect.push(DEFAULT_ENDPOINT.to_owned());
        }
        options
    }

    /// Where the session connects to, in words.
    pub fn place(&self) -> String {
        let files = [&self.secure, &self.zenoh_config];
        let file =
            files.into_iter().flatten().next().map(|file| format!("the endpoints of {}", file.display()));
        match self.connecting().connect {
            given if !given.is_empty() => given.join(", "),
            _ => file.unwrap_or_else(|| "any endpoint".to_owned()),
        }
    }

    /// Whether any of the switches is given.
    pub fn is_given(&self) -> bool {
        !self.says_nothing() || self.scout || self.namespace.is_some() || self.session_mode.is_some()
    }

    fn says_nothing(&self) -> bool {
        self.listen.is_empty()
            && self.connect.is_empty()
            && self.zenoh_config.is_none()
            && self.secure.is_none()
    }

    fn options(&self) -> SessionOptions {
        SessionOptions {
            config_file: self.zenoh_config.clone(),
            secure: self.secure.clone(),
            listen: self.listen.clone(),
            connect: self.connect.clone(),
            namespace: self.namespace.clone(),
            mode: self.session_mode,
            scout: self.scout,
        }
    }
}
