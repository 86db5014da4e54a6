//! A robot's connection to its map, which may come up after the robot.

use super::output::Connection;
use super::query_cameras::QueryImage;
use super::run::Robot;
use client::session::{SessionError, SessionOptions, close_session, open_session};
use client::{ClientError, MapChangeSubscriber, MapClient, QueryTasks};
use protocol::keys::{self, NameError};
use std::error::Error;
use std::time::Duration;
use tokio::runtime::Handle;
use tokio::task::JoinHandle;

/// How long a robot waits for its session before it starts without.
const START_WAIT: Duration = Duration::from_secs(2);

/// A connection to the map over an open session, which stays open when the run ends.
#[derive(Clone, Debug)]
pub struct MapLink {
    /// An open session.
    pub session: zenoh::Session,
    /// The runtime that the session lives on.
    pub runtime: Handle,
    /// Name of the map.
    pub map: String,
}

/// A connection to the map whose session is being opened, and is closed when the run ends.
#[derive(Debug)]
pub struct OpeningLink {
    opening: JoinHandle<Result<zenoh::Session, SessionError>>,
    runtime: Handle,
    map: String,
}

/// A robot's connection to the network.
#[derive(Debug)]
pub enum RobotLink {
    /// Over an open session, without a map: the robot publishes, and asks nothing.
    Network {
        /// An open session, which stays open when the run ends.
        session: zenoh::Session,
        /// The runtime that the session lives on.
        runtime: Handle,
    },
    /// Over an open session.
    Open(MapLink),
    /// Over a session that is being opened.
    Opening(OpeningLink),
}

/// Why a robot is not connected to the map.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LinkError {
    /// The name of the map cannot be part of a key.
    #[error(transparent)]
    MapName(#[from] NameError),
    /// The subscription to changes of the map failed.
    #[error(transparent)]
    Subscription(#[from] ClientError),
    /// An output cannot use the connection.
    #[error(transparent)]
    Output(Box<dyn Error + Send + Sync>),
}

impl From<MapLink> for RobotLink {
    fn from(link: MapLink) -> Self {
        Self::Open(link)
    }
}

impl From<OpeningLink> for RobotLink {
    fn from(link: OpeningLink) -> Self {
        Self::Opening(link)
    }
}

impl RobotLink {
    /// Name of the map, if there is one.
    pub fn map(&self) -> Option<&str> {
        match self {
            Self::Network { .. } => None,
            Self::Open(link) => Some(&link.map),
            Self::Opening(link) => Some(&link.map),
        }
    }
}

impl OpeningLink {
    /// Opens a session. Where nobody answers within 2 s this goes on in the background, and the robot starts with odometry.
    ///
    /// # Errors
    /// [`SessionError`]: options that cannot be used.
    pub fn open(options: SessionOptions, runtime: Handle, map: &str) -> Result<Self, SessionError> {
        options.to_config()?;
        let mut opening = runtime.spawn(async move { open_session(&options).await });
        let first = runtime.block_on(async { tokio::time::timeout(START_WAIT, &mut opening).await });
        match first {
            Ok(Ok(opened)) => {
                let session = opened?;
                opening = runtime.spawn(async { Ok(session) });
            }
            Ok(Err(panic)) => {
                return Err(SessionError::Open { listen: Vec::new(), problem: panic.to_string() });
            }
            Err(_) => tracing::warn!("no router and no map server answers yet: starting with odometry"),
        }
        Ok(Self { opening, runtime, map: map.to_owned() })
    }
}

/// What a run has of its connection.
#[derive(Default)]
pub(crate) struct MapConnection {
    /// Sends queries to the map server; `None` for odometry only, and before the session is open.
    pub(crate) queries: Option<QueryTasks<QueryImage>>,
    /// Receives changes of the map; `None` as of the queries.
    pub(crate) changes: Option<MapChangeSubscriber>,
    /// A session that is not open yet.
    opening: Option<OpeningLink>,
    /// The session that was opened for this run, and the runtime that it lives on.
    own_session: Option<(zenoh::Session, Handle)>,
    /// Why the last query was not answered; `None` once one is.
    pub(crate) last_failure: Option<String>,
}

impl MapConnection {
    /// Whether there is a map to ask, now or as soon as the session is open.
    pub(crate) fn has_map(&self) -> bool {
        self.queries.is_some() || self.opening.is_some()
    }

    /// Closes the session that was opened for this run, or ends opening it.
    pub(crate) fn close(&mut self) {
        if let Some(link) = self.opening.take() {
            link.opening.abort();
        }
        if let Some((session, runtime)) = self.own_session.take() {
            (self.queries, self.changes) = (None, None);
            runtime.block_on(close_session(&session));
        }
    }
}

impl Robot<'_> {
    /// Connects the robot and the outputs that were added before, now or when the session is open.
    ///
    /// # Errors
    /// [`LinkError`]: a name that no key can hold, a session that is closed, an output that cannot use it. With
    /// [`RobotLink::Opening`] what comes later is logged, and named in the status.
    pub fn connect(&mut self, link: impl Into<RobotLink>) -> Result<(), LinkError> {
        let link = link.into();
        link.map().map_or(Ok(()), keys::validate_name)?;
        match link {
            RobotLink::Network { session, runtime } => self.connect_outputs(&session, &runtime, None),
            RobotLink::Open(link) => self.connect_to_map(link),
            RobotLink::Opening(link) => {
                self.map.last_failure =
                    Some("not connected: no router and no map server answers yet".to_owned());
                self.map.opening = Some(link);
                self.connect_when_open();
                Ok(())
            }
        }
    }

    /// Connects the robot if its session was opened in the meantime.
    pub(crate) fn connect_when_open(&mut self) {
        let Some(link) = self.map.opening.take_if(|link| link.opening.is_finished()) else { return };
        let OpeningLink { opening, runtime, map } = link;
        let problem = match runtime.block_on(opening) {
            Ok(Ok(session)) => {
                self.map.own_session = Some((session.clone(), runtime.clone()));
                match self.connect_to_map(MapLink { session, runtime, map }) {
                    Ok(()) => {
                        self.map.last_failure = None;
                        return;
                    }
                    Err(error) => error.to_string(),
                }
            }
            Ok(Err(error)) => error.to_string(),
            Err(error) => error.to_string(),
        };
        tracing::error!(problem, "there will be no map in this run; odometry continues");
        self.map.last_failure = Some(problem);
    }

    fn connect_to_map(&mut self, link: MapLink) -> Result<(), LinkError> {
        let MapLink { session, runtime, map } = link;
        let client = MapClient::new(session.clone(), &map)?;
        self.map.changes = Some(runtime.block_on(MapChangeSubscriber::subscribe(&session, &map))?);
        self.connect_outputs(&session, &runtime, Some(&map))?;
        self.map.queries = Some(QueryTasks::new(client, runtime, self.settings.query_deadline));
        Ok(())
    }

    fn connect_outputs(
        &mut self,
        session: &zenoh::Session,
        runtime: &Handle,
        map: Option<&str>,
    ) -> Result<(), LinkError> {
        let connection = Connection::new(session, runtime, &self.settings.name, map);
        self.outputs.connect(&connection).map_err(LinkError::Output)
    }
}
