//! A small fleet in one process: routers, a map server, a robot and an operator, each with a session of its own.

use crate::attack::VICTIM;
use client::session::{SessionMode, SessionOptions, close_session, open_session};
use client::{MapChangeSubscriber, MapClient};
use map_server::{MapServer, ServedMap, ServerOptions};
use protocol::{Format, RobotState, RobotStatus};
use recognition::LoadedMap;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};
use testing::{Place, PlaceOptions};
use tools::fleet::{Fleet, FleetOptions, Validity};
use tools::in_process::free_endpoint;
use zenoh::handlers::FifoChannelHandler;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::sample::{Sample, SampleKind};

/// Name of the map.
pub const MAP: &str = "hall";
/// Within this time everything must work again; far beyond what is measured.
pub const PATIENCE: Duration = Duration::from_secs(30);

/// Options of a router.
pub fn router(listen: &str, connect: &[&str]) -> SessionOptions {
    SessionOptions { mode: Some(SessionMode::Router), ..session(&[listen], connect) }
}

/// Options of a program with `--listen` and `--connect`.
pub fn session(listen: &[&str], connect: &[&str]) -> SessionOptions {
    let owned = |endpoints: &[&str]| endpoints.iter().map(|&endpoint| endpoint.to_owned()).collect();
    SessionOptions { listen: owned(listen), connect: owned(connect), ..SessionOptions::default() }
}

/// A member of a secured fleet.
pub fn member(folder: &Path, name: &str) -> SessionOptions {
    SessionOptions { secure: Some(folder.join(name)), ..SessionOptions::default() }
}

/// A secured fleet with a server `south`, the robots `ada` and `bo`, and the operator `ann`.
pub fn secured(folder: &Path, router: bool) -> Fleet {
    let endpoint = free_endpoint().unwrap();
    let mut options = FleetOptions::new("127.0.0.1");
    options.port = endpoint.rsplit(':').next().unwrap().parse().unwrap();
    options.servers = vec!["south".into()];
    options.robots = vec![VICTIM.into(), "bo".into()];
    options.operators = vec!["ann".into()];
    options.router = router;
    Fleet::init(folder, options, Validity::default()).unwrap()
}

/// A small map in its versions.
pub fn map(version: u64) -> Arc<LoadedMap> {
    let place = Place::new(&PlaceOptions { keyframes: 5, landmarks: 100, ..PlaceOptions::default() });
    let mut contents = place.map;
    contents.info.version = version;
    Arc::new(LoadedMap::from_contents(contents).unwrap())
}

/// A map server with its session.
pub struct FleetServer {
    session: zenoh::Session,
    server: MapServer,
    version: u64,
}

impl FleetServer {
    /// Serves [`MAP`] as `south`.
    pub async fn start(options: &SessionOptions) -> Self {
        let session = open_session(options).await.unwrap();
        let maps = vec![ServedMap { name: MAP.to_owned(), map: map(1) }];
        let mut options = ServerOptions::default();
        options.name = Some("south".to_owned());
        let server = MapServer::start(session.clone(), maps, options).await.unwrap();
        Self { session, server, version: 1 }
    }

    /// Publishes a new version of the map.
    pub async fn change(&mut self) -> u64 {
        self.version += 1;
        self.server.replace(MAP, map(self.version), None).await.unwrap();
        self.version
    }

    /// Stops the server as its program does.
    pub async fn stop(self) {
        self.server.stop().await.unwrap();
        close_session(&self.session).await;
    }
}

/// What a robot has on the network.
pub struct FleetRobot {
    name: String,
    /// Its session.
    pub session: zenoh::Session,
    /// Its queries.
    pub map: MapClient,
    changes: MapChangeSubscriber,
    _token: LivelinessToken,
}

impl FleetRobot {
    /// A robot of a name.
    pub async fn start(name: &str, options: &SessionOptions) -> Self {
        let session = open_session(options).await.unwrap();
        let token = session.liveliness().declare_token(protocol::keys::robot(name).unwrap()).await.unwrap();
        let changes = MapChangeSubscriber::subscribe(&session, MAP).await.unwrap();
        let map = MapClient::new(session.clone(), MAP).unwrap();
        Self { name: name.to_owned(), session, map, changes, _token: token }
    }

    /// Asks until the server answers.
    ///
    /// # Returns
    /// The time that it took.
    pub async fn first_answer(&self) -> Duration {
        let begin = Instant::now();
        let info = self.map.info(begin + PATIENCE).await.unwrap();
        assert_eq!(info.name, MAP);
        begin.elapsed()
    }

    /// Publishes a status.
    pub async fn publish(&self, stamp_ns: i64) {
        let status = RobotStatus {
            stamp_ns,
            state: RobotState::Localized,
            reason: String::new(),
            map: Some(MAP.to_owned()),
            last_map_update_ns: None,
            keyframes_held: 0,
            queries_sent: 0,
            queries_answered: 0,
        };
        let payload = protocol::encode(Format::Bincode, &status).unwrap();
        let key = protocol::keys::robot_status(&self.name).unwrap();
        self.session.put(key, payload).encoding(Format::Bincode.encoding()).await.unwrap();
    }

    /// The newest version that the robot was told of.
    pub fn told_version(&mut self) -> Option<u64> {
        std::iter::from_fn(|| self.changes.poll()).last().map(|notice| notice.version)
    }
}

/// Who watches the fleet.
pub struct FleetOperator {
    /// The session.
    pub session: zenoh::Session,
    statuses: Subscriber<FifoChannelHandler<Sample>>,
}

impl FleetOperator {
    /// Subscribes to the status of all robots.
    pub async fn start(options: &SessionOptions) -> Self {
        let session = open_session(options).await.unwrap();
        let statuses = session.declare_subscriber("robot/*/status").await.unwrap();
        Self { session, statuses }
    }

    /// Keys and times of the statuses that came since the last call.
    pub fn heard(&self) -> Vec<(String, i64)> {
        let read = |sample: Sample| {
            let status: RobotStatus =
                protocol::decode(Format::Bincode, &sample.payload().to_bytes()).unwrap();
            (sample.key_expr().to_string(), status.stamp_ns)
        };
        self.statuses.drain().map(read).collect()
    }

    /// Liveliness tokens, asked now.
    pub async fn tokens(&self) -> Vec<String> {
        let replies = self.session.liveliness().get("**").timeout(Duration::from_secs(1)).await.unwrap();
        let mut tokens = Vec::new();
        while let Ok(reply) = replies.recv_async().await {
            if let Some(sample) = reply.result().ok().filter(|sample| sample.kind() == SampleKind::Put) {
                tokens.push(sample.key_expr().to_string());
            }
        }
        tokens.sort();
        tokens
    }
}

/// Asserts that queries, statuses, tokens and changes of the map arrive, within [`PATIENCE`].
///
/// # Returns
/// The time until the first answer to a query.
pub async fn assert_works(
    server: &mut FleetServer,
    robot: &mut FleetRobot,
    operator: &FleetOperator,
) -> Duration {
    let begin = Instant::now();
    let first_answer = robot.first_answer().await;
    let status = (format!("robot/{}/status", robot.name), 7);
    let tokens = ["map_server/south".to_owned(), format!("robot/{}", robot.name)];
    let (mut heard, mut told, mut seen) = (false, false, Vec::new());
    operator.heard();
    robot.told_version();
    while !(heard && told && tokens.iter().all(|token| seen.contains(token))) {
        assert!(begin.elapsed() < PATIENCE, "status {heard}, change of the map {told}, tokens {seen:?}");
        robot.publish(7).await;
        let version = server.change().await;
        tokio::time::sleep(Duration::from_millis(50)).await;
        heard |= operator.heard().contains(&status);
        told |= robot.told_version().is_some_and(|known| known <= version);
        seen = operator.tokens().await;
    }
    first_answer
}
