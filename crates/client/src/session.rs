//! Opening a Zenoh session from a few options.
//!
//! Zenoh's defaults find peers by multicast and listen on every interface. Driftless does neither unless configured:
//! robots of two fleets in the same Wi-Fi must not connect to each other's servers.

use std::path::PathBuf;
use std::time::Duration;

/// Default endpoint of servers and clients.
pub const DEFAULT_ENDPOINT: &str = "tcp/127.0.0.1:7447";

const LISTEN: &str = "the endpoint to listen on";
const CONNECT: &str = "the endpoint to connect to";

/// Longest message that a session receives, bytes: a payload, and what Zenoh puts around it.
const MAX_MESSAGE: usize = protocol::MAX_MESSAGE_BYTES + (64 << 10);

/// How long closing a session may take.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(5);

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
    /// A Zenoh configuration file (JSON5); fields below that are set override it. `None`: a peer without multicast
    /// scouting.
    pub config_file: Option<PathBuf>,
    /// Endpoints to listen on, for example `tcp/0.0.0.0:7447`. Empty: none, or those of the file.
    pub listen: Vec<String>,
    /// Endpoints to connect to, retried until they answer. Empty: none, or those of the file.
    pub connect: Vec<String>,
    /// Prefix of every key, one namespace per fleet. `None`: none, or that of the file.
    pub namespace: Option<String>,
    /// Whether this session forwards messages between the sessions connected to it. A single map server does not need
    /// it; robots that should receive each other's messages do.
    pub router: bool,
}

/// Why a session was not opened.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SessionError {
    /// The configuration file cannot be used.
    #[error("the Zenoh configuration {path} cannot be used: {problem}")]
    ConfigFile {
        /// The file.
        path: PathBuf,
        /// Error of Zenoh.
        problem: String,
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
    /// An endpoint has no protocol or no port.
    #[error("{what} {value:?} is no endpoint: write {suggestion} (protocol/address:port)")]
    Endpoint {
        /// What it is for.
        what: &'static str,
        /// As given.
        value: String,
        /// What was probably meant.
        suggestion: String,
    },
    /// Zenoh did not open the session.
    #[error(
        "the Zenoh session did not open (listening on {listen:?}): {problem}; is the port taken already?"
    )]
    Open {
        /// Endpoints to listen on.
        listen: Vec<String>,
        /// Error of Zenoh.
        problem: String,
    },
}

impl SessionOptions {
    /// The Zenoh configuration of these options.
    ///
    /// # Errors
    /// [`SessionError::ConfigFile`], [`SessionError::Endpoint`], [`SessionError::Value`].
    pub fn to_config(&self) -> Result<zenoh::Config, SessionError> {
        let mut config = match &self.config_file {
            Some(path) => zenoh::Config::from_file(path).map_err(|problem| SessionError::ConfigFile {
                path: path.clone(),
                problem: problem.to_string(),
            })?,
            None => closed_config()?,
        };
        // Nothing longer is ever sent; Zenoh would take up to 1 GiB into memory.
        insert(&mut config, "transport/link/rx/max_message_size", "message size", &MAX_MESSAGE)?;
        if self.router {
            insert(&mut config, "mode", "mode", "router")?;
        }
        for (key, what, endpoints) in
            [("listen/endpoints", LISTEN, &self.listen), ("connect/endpoints", CONNECT, &self.connect)]
        {
            endpoints.iter().try_for_each(|endpoint| check_endpoint(what, endpoint))?;
            if !endpoints.is_empty() {
                insert(&mut config, key, what, endpoints)?;
            }
        }
        if let Some(namespace) = &self.namespace {
            insert(&mut config, "namespace", "the namespace", namespace)?;
        }
        Ok(config)
    }
}

/// Opens a session. It is open as soon as it listens; connecting continues in the background.
///
/// Needs a multi-threaded tokio runtime, as Zenoh does.
///
/// # Errors
/// [`SessionError`]: an unusable option, or an endpoint that cannot be listened on.
pub async fn open_session(options: &SessionOptions) -> Result<zenoh::Session, SessionError> {
    let config = options.to_config()?;
    zenoh::open(config).await.map_err(|problem| SessionError::Open {
        listen: options.listen.clone(),
        problem: problem.to_string(),
    })
}

/// Closes a session; returns after 5 s at the latest, if the other side does not respond.
pub async fn close_session(session: &zenoh::Session) {
    match tokio::time::timeout(CLOSE_TIMEOUT, session.close()).await {
        Ok(Ok(())) => {}
        Ok(Err(error)) => tracing::warn!("closing the Zenoh session failed: {error}"),
        Err(_) => tracing::warn!("closing the Zenoh session took longer than {CLOSE_TIMEOUT:?}, left it"),
    }
}

/// A peer that does not listen, connect or scout.
fn closed_config() -> Result<zenoh::Config, SessionError> {
    let mut config = zenoh::Config::default();
    insert(&mut config, "mode", "mode", "peer")?;
    insert(&mut config, "scouting/multicast/enabled", "multicast scouting", &false)?;
    insert(&mut config, "listen/endpoints", LISTEN, &Vec::<String>::new())?;
    insert(&mut config, "connect/endpoints", CONNECT, &Vec::<String>::new())?;
    Ok(config)
}

/// Checks that an endpoint is written as `protocol/address:port`; which protocols there are, Zenoh says.
fn check_endpoint(what: &'static str, value: &str) -> Result<(), SessionError> {
    // As in a URL, which many write first.
    let (protocol, locator) = match value.split_once("://") {
        Some((_, locator)) => (None, locator),
        None => value.split_once('/').map_or((None, value), |(protocol, locator)| (Some(protocol), locator)),
    };
    // Metadata and configuration may follow.
    let address = locator.split(['?', '#']).next().unwrap_or_default().trim_end_matches('/');
    let is_port = |port: &str| port.parse::<u16>().is_ok();
    let has_port = address.rsplit_once(':').is_some_and(|(host, port)| !host.is_empty() && is_port(port));
    // Protocols of the local machine have paths for addresses.
    let needs_port = !matches!(protocol, Some("unixsock-stream" | "unixpipe" | "serial"));
    if protocol.is_some_and(|protocol| !protocol.is_empty()) && (has_port || !needs_port) {
        return Ok(());
    }
    let host = if has_port { address.to_owned() } else { format!("{}:7447", address.trim_end_matches(':')) };
    let suggestion = format!("{}/{host}", protocol.filter(|protocol| !protocol.is_empty()).unwrap_or("tcp"));
    Err(SessionError::Endpoint { what, value: value.to_owned(), suggestion })
}

fn insert<T: serde::Serialize + ?Sized>(
    config: &mut zenoh::Config,
    key: &str,
    what: &'static str,
    value: &T,
) -> Result<(), SessionError> {
    let failed = |value: String, problem: String| SessionError::Value { what, value, problem };
    let json = serde_json::to_string(value).map_err(|problem| failed(String::new(), problem.to_string()))?;
    config.insert_json5(key, &json).map_err(|problem| failed(json.clone(), problem.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_endpoint_without_protocol_or_port_is_refused_with_the_corrected_one() {
        for (given, suggestion) in [
            ("10.0.0.1:7447", "tcp/10.0.0.1:7447"),
            ("10.0.0.1", "tcp/10.0.0.1:7447"),
            ("tcp/10.0.0.1", "tcp/10.0.0.1:7447"),
            ("tcp://robot7:7448", "tcp/robot7:7448"),
            ("http://robot7:7448/", "tcp/robot7:7448"),
            ("/robot7:7448", "tcp/robot7:7448"),
            ("[fe80::1]:7447", "tcp/[fe80::1]:7447"),
            ("localhost:port", "tcp/localhost:port:7447"),
        ] {
            let robot = SessionOptions { connect: vec![given.to_owned()], ..SessionOptions::default() };
            let server = SessionOptions { listen: vec![given.to_owned()], ..SessionOptions::default() };
            for (options, what) in [(robot, "connect to"), (server, "listen on")] {
                let error = options.to_config().unwrap_err().to_string();
                assert!(error.contains(what) && error.contains(&format!("write {suggestion} ")), "{error}");
                assert!(error.contains(given) && !error.contains('{'), "{error}");
            }
        }
    }

    #[test]
    fn endpoints_of_zenoh_pass() {
        for given in
            ["tcp/127.0.0.1:7447", "tcp/[::1]:0", "tcp/host.local:7447?prio=1-3", "unixsock-stream/run/map"]
        {
            assert!(check_endpoint(CONNECT, given).is_ok(), "{given}");
        }
    }
}
