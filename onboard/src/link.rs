//! A robot's connection to its map, which may come up after the robot.

use super::outputs::{Publisher, PublisherError};
use super::run::RobotRun;
use client::session::{SessionError, SessionOptions, close_session, open_session};
use client::{ClientError, MapChangeSubscriber, MapClient, QueryTasks};
use protocol::keys::{self, NameError};
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
    #[error("--map: {0}")]
    MapName(#[from] NameError),
    /// The subscription to changes of the map failed.
    #[error(transparent)]
    Subscription(#[from] ClientError),
    /// The robot cannot publish.
    #[error(transparent)]
    Publisher(#[from] PublisherError),
}

impl From<MapLink> for RobotLink {
    fn from(link: MapLink) -> Self {
        Self::Open(link)
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

impl RobotRun<'_> {
    /// Connects the robot, now or when the session is open.
    pub(super) fn set_link(&mut self, link: RobotLink) -> Result<(), LinkError> {
        link.map().map_or(Ok(()), keys::validate_name)?;
        match link {
            RobotLink::Network { session, runtime } => {
                self.publisher = Some(Publisher::new(session, &runtime, &self.robot, None, self.topics)?);
                Ok(())
            }
            RobotLink::Open(link) => self.connect(link),
            RobotLink::Opening(link) => {
                self.last_failure = Some("not connected: no router and no map server answers yet".to_owned());
                self.opening = Some(link);
                self.connect_when_open();
                Ok(())
            }
        }
    }

    /// Connects the robot if its session was opened in the meantime.
    pub(super) fn connect_when_open(&mut self) {
        let Some(link) = self.opening.take_if(|link| link.opening.is_finished()) else { return };
        let OpeningLink { opening, runtime, map } = link;
        let problem = match runtime.block_on(opening) {
            Ok(Ok(session)) => {
                self.own_session = Some((session.clone(), runtime.clone()));
                match self.connect(MapLink { session, runtime, map }) {
                    Ok(()) => {
                        self.last_failure = None;
                        return;
                    }
                    Err(error) => error.to_string(),
                }
            }
            Ok(Err(error)) => error.to_string(),
            Err(error) => error.to_string(),
        };
        tracing::error!(problem, "there will be no map in this run; odometry continues");
        self.last_failure = Some(problem);
    }

    fn connect(&mut self, link: MapLink) -> Result<(), LinkError> {
        let MapLink { session, runtime, map } = link;
        let client = MapClient::new(session.clone(), &map)?;
        self.map_changes = Some(runtime.block_on(MapChangeSubscriber::subscribe(&session, &map))?);
        self.publisher = Some(Publisher::new(session, &runtime, &self.robot, Some(&map), self.topics)?);
        self.queries = Some(QueryTasks::new(client, runtime, self.query_deadline));
        Ok(())
    }

    /// Closes the session that was opened for this run, or ends opening it.
    pub(super) fn disconnect(&mut self) {
        if let Some(link) = self.opening.take() {
            link.opening.abort();
        }
        if let Some((session, runtime)) = self.own_session.take() {
            (self.queries, self.map_changes) = (None, None);
            runtime.block_on(close_session(&session));
        }
    }
}
