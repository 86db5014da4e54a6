//! Opening a Zenoh session from a few options.
//!
//! Zenoh's defaults find peers by multicast and listen on every interface. Driftless does neither unless asked:
//! robots of two fleets in the same Wi-Fi must not connect to each other's servers.
//!
//! # Mode of a session
//! | given | mode | why |
//! |---|---|---|
//! | one endpoint to connect to | client | a router, or a listening server, forwards between its clients, and not between peers |
//! | several endpoints to connect to | router | a client connects to one of them only |
//! | endpoints to listen on | peer | forwards between the clients that connect to it |
//! | both | router | forwards between the two sides |
//! | multicast scouting, or nothing | peer | |
//!
//! [`SessionOptions::mode`], or the configuration file, overrides it.

mod checks;
mod endpoint;
mod error;
mod member;
mod open;

pub use endpoint::EndpointError;
pub use error::SessionError;
pub use member::{CONFIG_FILE, Member, Role};
pub use open::{close_session, open_session};

use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Default endpoint of servers and clients.
pub const DEFAULT_ENDPOINT: &str = "tcp/127.0.0.1:7447";

/// Where endpoints are in a configuration, and what for.
const ENDPOINTS: [(&str, &str); 2] = [
    ("/listen/endpoints", "the endpoint to listen on"),
    ("/connect/endpoints", "the endpoint to connect to"),
];

/// First and longest pause between two attempts to connect, milliseconds: a robot is back within a second of its router.
const RETRY_MS: (u64, u64) = (100, 1000);
/// A link without a sign of life for this long is closed, milliseconds.
const LEASE_MS: u64 = 4000;
/// Signs of life in this time, where nothing else is sent.
const KEEP_ALIVES: u64 = 4;
/// How long one attempt to connect may take, milliseconds: packets to a machine that is off are not answered.
const OPEN_TIMEOUT_MS: u64 = 4000;

/// Most sessions that are connected to one at a time, as a configuration file may change it: each takes a socket and about 60 kB, and
/// further ones are refused until one of them ends.
pub const MAX_SESSIONS: usize = 1000;

/// Longest message that a session receives, bytes: a payload, and what Zenoh puts around it.
const MAX_MESSAGE: usize = protocol::MAX_MESSAGE_BYTES + (64 << 10);

/// What a session is in the network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "arguments", derive(clap::ValueEnum))]
pub enum SessionMode {
    /// Connects to one router or peer, which forwards.
    Client,
    /// Connects to all it knows, and forwards to its clients.
    Peer,
    /// Forwards between all that are connected.
    Router,
}

impl SessionMode {
    /// Zenoh's word.
    pub fn name(self) -> &'static str {
        match self {
            Self::Client => "client",
            Self::Peer => "peer",
            Self::Router => "router",
        }
    }
}

/// Options of a session.
///
/// # Example
/// ```
/// use client::SessionOptions;
///
/// let server = SessionOptions { listen: vec!["tcp/127.0.0.1:7447".into()], ..SessionOptions::default() };
/// let robot = SessionOptions { connect: server.listen.clone(), ..SessionOptions::default() };
/// assert!(server.to_config().is_ok() && robot.to_config().is_ok());
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SessionOptions {
    /// A Zenoh configuration file (JSON5); fields below that are set override it.
    pub config_file: Option<PathBuf>,
    /// Folder of one member of a secured fleet, as `driftless fleet init` writes it; instead of a configuration file.
    pub secure: Option<PathBuf>,
    /// Endpoints to listen on, for example `tcp/0.0.0.0:7447`. Empty: none, or those of the file.
    pub listen: Vec<String>,
    /// Endpoints to connect to, retried until they answer. Empty: none, or those of the file.
    pub connect: Vec<String>,
    /// Prefix of every key, one namespace per fleet. `None`: none, or that of the file.
    pub namespace: Option<String>,
    /// `None`: as the file says, else as the [module](self) says.
    pub mode: Option<SessionMode>,
    /// Find routers and peers by multicast.
    pub scout: bool,
}

impl SessionOptions {
    /// The Zenoh configuration of these options.
    ///
    /// # Errors
    /// [`SessionError`]: a file that cannot be read, a value that Zenoh does not accept or that this build cannot do.
    pub fn to_config(&self) -> Result<zenoh::Config, SessionError> {
        self.zenoh_config(&self.settings()?)
    }

    fn zenoh_config(&self, settings: &Value) -> Result<zenoh::Config, SessionError> {
        let path = self.file().unwrap_or_default();
        zenoh::Config::from_json5(&settings.to_string())
            .map_err(|problem| SessionError::ConfigFile { path, problem: problem.to_string() })
    }

    /// The file that these options name.
    fn file(&self) -> Option<PathBuf> {
        self.secure.as_ref().map(|folder| folder.join(CONFIG_FILE)).or_else(|| self.config_file.clone())
    }

    /// The configuration as Zenoh reads it: defaults, overridden by the file, then by the options.
    fn settings(&self) -> Result<Value, SessionError> {
        let mut settings = defaults();
        if let Some(path) = self.file() {
            let mut file = read(&path)?;
            if let Some(folder) = &self.secure {
                Member::read(folder)?;
                member::resolve_files(&mut file, folder);
            }
            merge(&mut settings, file);
        }
        // Nothing longer is ever sent; Zenoh would take up to 1 GiB into memory.
        merge(&mut settings, nested("/transport/link/rx/max_message_size", json!(MAX_MESSAGE)));
        for ((key, _), given) in ENDPOINTS.iter().zip([&self.listen, &self.connect]) {
            if !given.is_empty() {
                merge(&mut settings, nested(key, json!(given)));
            }
        }
        if let Some(namespace) = &self.namespace {
            check_namespace(namespace)?;
            merge(&mut settings, json!({ "namespace": namespace }));
        }
        if self.scout {
            merge(&mut settings, nested("/scouting/multicast/enabled", json!(true)));
        }
        checks::check_endpoints(&settings, self.secure.is_some())?;
        checks::check_files(&settings)?;
        let mode = self.choose_mode(&settings)?;
        merge(&mut settings, json!({ "mode": mode.name() }));
        if mode == SessionMode::Client {
            // One attempt at each endpoint: with more, Zenoh stays at the first one.
            merge(&mut settings, json!({ "connect": { "timeout_ms": 0 } }));
        }
        Ok(settings)
    }

    fn choose_mode(&self, settings: &Value) -> Result<SessionMode, SessionError> {
        let count = |key| checks::endpoints(settings, key).len();
        let (listening, connecting) = (count("/listen/endpoints"), count("/connect/endpoints"));
        let scouting = settings.pointer("/scouting/multicast/enabled") == Some(&Value::Bool(true));
        let of_file = match settings.get("mode").and_then(Value::as_str) {
            Some("client") => Some(SessionMode::Client),
            Some("router") => Some(SessionMode::Router),
            Some("peer") => Some(SessionMode::Peer),
            _ => None,
        };
        let mode = self.mode.or(of_file).unwrap_or(match (listening, connecting) {
            (0, 1) if !scouting => SessionMode::Client,
            (_, 1..) if !scouting => SessionMode::Router,
            _ => SessionMode::Peer,
        });
        if mode == SessionMode::Client && connecting == 0 && !scouting {
            return Err(SessionError::ClientOfNobody);
        }
        Ok(mode)
    }
}

/// Neither listens, nor connects, nor scouts; comes back quickly when a link was lost.
fn defaults() -> Value {
    let (period_init_ms, period_max_ms) = RETRY_MS;
    let retry = json!({
        "period_init_ms": period_init_ms, "period_max_ms": period_max_ms, "period_increase_factor": 2
    });
    json!({
        "scouting": { "multicast": { "enabled": false } },
        "listen": { "endpoints": [] },
        "connect": { "endpoints": [], "exit_on_failure": false, "retry": retry },
        "transport": {
            "unicast": { "open_timeout": OPEN_TIMEOUT_MS, "max_sessions": MAX_SESSIONS },
            "link": { "tx": { "lease": LEASE_MS, "keep_alive": KEEP_ALIVES } }
        }
    })
}

/// Reads a configuration file, and refuses what this build would ignore.
fn read(path: &Path) -> Result<Value, SessionError> {
    let failed = |problem: String| SessionError::ConfigFile { path: path.to_owned(), problem };
    let text = files::read_to_string(path).map_err(|error| failed(error.to_string()))?;
    // The parser's own message quotes the line, which may hold a password.
    let value: Value = json5::from_str(&text).map_err(|json5::Error::Message { location, .. }| {
        let place =
            location.map_or(String::new(), |at| format!(" at line {}, column {}", at.line, at.column));
        failed(format!("it is not JSON5{place}"))
    })?;
    // On its own, so that an unknown key is refused even where an option overrides it.
    zenoh::Config::from_json5(&value.to_string()).map_err(|problem| failed(problem.to_string()))?;
    checks::check_features(path, &value)?;
    Ok(value)
}

/// Checks a namespace.
///
/// # Errors
/// [`SessionError::Value`] if one of its names cannot be part of a key.
pub fn check_namespace(namespace: &str) -> Result<(), SessionError> {
    let failed =
        |problem: String| SessionError::Value { what: "the namespace", value: namespace.to_owned(), problem };
    namespace
        .split('/')
        .try_for_each(protocol::keys::validate_name)
        .map_err(|error| failed(error.to_string()))
}

/// A value below a path of keys.
fn nested(pointer: &str, value: Value) -> Value {
    pointer.rsplit('/').filter(|key| !key.is_empty()).fold(value, |value, key| json!({ key: value }))
}

/// Overrides the fields of one configuration by those of another.
fn merge(settings: &mut Value, with: Value) {
    match (settings, with) {
        (Value::Object(fields), Value::Object(with)) => {
            for (key, value) in with {
                merge(fields.entry(key).or_insert(Value::Null), value);
            }
        }
        (settings, with) => *settings = with,
    }
}

#[cfg(test)]
mod tests;
