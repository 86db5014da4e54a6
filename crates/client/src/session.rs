//! Opening a Zenoh session from the few switches that people need, without knowing about maps.
//!
//! Zenoh's defaults look for peers by multicast and listen on every interface. Driftless does neither by itself:
//! a robot should not join a stranger's map because it shares the hall's Wi-Fi.

use std::path::PathBuf;
use std::time::Duration;

/// Where programs listen and connect when nothing else is said.
pub const DEFAULT_ENDPOINT: &str = "tcp/127.0.0.1:7447";

/// How long closing a session may take.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(5);

/// What a session takes part in.
///
/// # Example
/// ```
/// use client::session::SessionOptions;
///
/// let server = SessionOptions { listen: vec!["tcp/127.0.0.1:7447".into()], ..SessionOptions::default() };
/// let robot = SessionOptions { connect: server.listen.clone(), ..SessionOptions::default() };
/// assert!(server.to_config().is_ok() && robot.to_config().is_ok());
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SessionOptions {
    /// A Zenoh configuration file (JSON5) to begin with; the other fields override it where they say something.
    /// `None`: a peer without multicast scouting.
    pub config_file: Option<PathBuf>,
    /// Endpoints to listen on, for example `tcp/0.0.0.0:7447`. Empty: none (or those of the file).
    pub listen: Vec<String>,
    /// Endpoints to connect to, again and again until one answers. Empty: none (or those of the file).
    pub connect: Vec<String>,
    /// Prefix of every key: one namespace is one fleet. `None`: none (or that of the file).
    pub namespace: Option<String>,
    /// Whether this session passes on messages between those that connect to it. Not known to be needed for one
    /// server: robots that should hear each other connect to a router.
    pub router: bool,
}

/// Why there is no session.
#[derive(Debug, thiserror::Error)]
pub enum SessionError {
    /// The configuration file cannot be used.
    #[error("the Zenoh configuration {path} cannot be used: {problem}")]
    ConfigFile {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
    },
    /// A switch has an impossible value.
    #[error("{what} {value:?} cannot be used: {problem}")]
    Value {
        /// Which switch.
        what: &'static str,
        /// What was given.
        value: String,
        /// Why not.
        problem: String,
    },
    /// Zenoh did not open the session.
    #[error(
        "the Zenoh session did not open (listening on {listen:?}): {problem}; is the port taken already?"
    )]
    Open {
        /// Endpoints that it should have listened on.
        listen: Vec<String>,
        /// What Zenoh says.
        problem: String,
    },
}

impl SessionOptions {
    /// The Zenoh configuration that these options stand for.
    ///
    /// # Errors
    /// [`SessionError::ConfigFile`], [`SessionError::Value`].
    pub fn to_config(&self) -> Result<zenoh::Config, SessionError> {
        let mut config = match &self.config_file {
            Some(path) => zenoh::Config::from_file(path).map_err(|problem| SessionError::ConfigFile {
                path: path.clone(),
                problem: problem.to_string(),
            })?,
            None => closed_config()?,
        };
        if self.router {
            insert(&mut config, "mode", "mode", "router")?;
        }
        if !self.listen.is_empty() {
            insert(&mut config, "listen/endpoints", "the endpoint to listen on", &self.listen)?;
        }
        if !self.connect.is_empty() {
            insert(&mut config, "connect/endpoints", "the endpoint to connect to", &self.connect)?;
        }
        if let Some(namespace) = &self.namespace {
            insert(&mut config, "namespace", "the namespace", namespace)?;
        }
        Ok(config)
    }
}

/// Opens a session. It is open as soon as it listens; connecting goes on in the background.
///
/// Needs a multi-threaded tokio runtime, as Zenoh does.
///
/// # Errors
/// [`SessionError`].
pub async fn open_session(options: &SessionOptions) -> Result<zenoh::Session, SessionError> {
    let config = options.to_config()?;
    zenoh::open(config).await.map_err(|problem| SessionError::Open {
        listen: options.listen.clone(),
        problem: problem.to_string(),
    })
}

/// Closes a session, and gives up after 5 s where the other side does not take part in it.
pub async fn close_session(session: &zenoh::Session) {
    match tokio::time::timeout(CLOSE_TIMEOUT, session.close()).await {
        Ok(Ok(())) => {}
        Ok(Err(error)) => tracing::warn!("closing the Zenoh session failed: {error}"),
        Err(_) => tracing::warn!("closing the Zenoh session took longer than {CLOSE_TIMEOUT:?}, left it"),
    }
}

/// A peer that listens nowhere, connects nowhere and looks for nobody.
fn closed_config() -> Result<zenoh::Config, SessionError> {
    let mut config = zenoh::Config::default();
    insert(&mut config, "mode", "mode", "peer")?;
    insert(&mut config, "scouting/multicast/enabled", "multicast scouting", &false)?;
    insert(&mut config, "listen/endpoints", "the endpoint to listen on", &Vec::<String>::new())?;
    insert(&mut config, "connect/endpoints", "the endpoint to connect to", &Vec::<String>::new())?;
    Ok(config)
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
