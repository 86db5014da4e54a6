//! A viewer of a real map with robots over a real session.
#![allow(clippy::unwrap_used, dead_code)]

use client::{SessionOptions, open_session};
use geometry::uncertain_pose::isotropic_covariance;
use geometry::{Pose, PoseWithCovariance};
use nalgebra::{UnitQuaternion, Vector3};
use protocol::{
    Format, KeyframeId, MapIdentity, MatchOutcome, Message, RobotOdometry, RobotPose, RobotState,
    RobotStatus, keys,
};
use std::net::SocketAddr;
use std::sync::Arc;
use testing::{Place, PlaceOptions};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use viewer::{
    CandidateVerdict, RobotFollower, RunTracks, ViewedAnswer, ViewedCandidate, ViewedMap, ViewedQuery,
    ViewedResult, Viewer, ViewerServer, follow_robots,
};
use zenoh::Session;

pub struct Shown {
    pub place: Place,
    pub viewer: Arc<Viewer>,
    pub server: ViewerServer,
    pub session: Session,
    _robots: RobotFollower,
}

impl Shown {
    pub async fn start() -> Self {
        Self::start_with(None).await
    }

    pub async fn start_with(run: Option<RunTracks>) -> Self {
        let mut place = Place::new(&PlaceOptions::default());
        place.map.info.version = 3;
        let viewer = Viewer::with_run(run);
        viewer.set_map(ViewedMap::of_contents("place", &place.map));
        let session = open_session(&SessionOptions::default()).await.unwrap();
        let robots = follow_robots(&viewer, &session).await.unwrap();
        let server = ViewerServer::start(([127, 0, 0, 1], 0).into(), Arc::clone(&viewer)).await.unwrap();
        Self { place, viewer, server, session, _robots: robots }
    }

    pub fn address(&self) -> SocketAddr {
        self.server.address()
    }

    /// The body as bytes, of a GET that succeeds.
    pub async fn body(&self, path: &str) -> Vec<u8> {
        let response = get(self.address(), path).await;
        let end = response.windows(4).position(|bytes| bytes == b"\r\n\r\n").unwrap();
        assert!(
            response.starts_with(b"HTTP/1.1 200"),
            "{path}: {}",
            String::from_utf8_lossy(&response[..end])
        );
        response[end + 4..].to_vec()
    }

    /// The JSON of a GET that succeeds.
    pub async fn json(&self, path: &str) -> serde_json::Value {
        serde_json::from_slice(&self.body(path).await).unwrap()
    }

    pub async fn publish<M: Message>(&self, key: String, message: &M) {
        let payload = protocol::encode(Format::Json, message).unwrap();
        self.session.put(key, payload).encoding(Format::Json.encoding()).await.unwrap();
    }

    /// A robot at a place of the path, with everything that it publishes.
    pub async fn publish_robot(&self, robot: &str, x_m: f64, state: RobotState) -> Vector3<f64> {
        let global_from_imu = self.robot_at(x_m);
        let local_from_imu = Pose::new(UnitQuaternion::identity(), Vector3::new(x_m, 0.02 * x_m, 0.0));
        let global_from_local = global_from_imu * local_from_imu.inverse();
        let with = |pose, sigma_m| PoseWithCovariance::new(pose, isotropic_covariance(0.01, sigma_m));
        let stamp_ns = (x_m * 1e9) as i64;
        let pose = RobotPose {
            stamp_ns,
            map: "place".to_owned(),
            map_version: 1,
            map_identity: MapIdentity::from_bytes([7; 16]),
            global_from_imu: with(global_from_imu, 0.15),
            global_from_local: with(global_from_local, 0.15),
        };
        let odometry = RobotOdometry {
            stamp_ns,
            local_from_imu: with(local_from_imu, 0.3),
            velocity_in_local: [3.0, 0.0, 4.0],
            angular_velocity_in_imu: [0.0; 3],
        };
        self.publish(keys::robot_pose(robot).unwrap(), &pose).await;
        self.publish(keys::robot_odometry(robot).unwrap(), &odometry).await;
        self.publish_status(robot, stamp_ns, state).await;
        global_from_imu.translation
    }

    pub async fn publish_status(&self, robot: &str, stamp_ns: i64, state: RobotState) {
        let status = RobotStatus {
            stamp_ns,
            state,
            reason: reason(state).to_owned(),
            map: Some("place".to_owned()),
            last_map_update_ns: Some(stamp_ns),
            keyframes_held: 12,
            queries_sent: 31,
            queries_answered: 30,
        };
        self.publish(keys::robot_status(robot).unwrap(), &status).await;
    }

    /// The body's axes x forward, y left, z up.
    fn robot_at(&self, x_m: f64) -> Pose {
        let camera = self.place.camera_at(x_m, 0.8 * (x_m / 6.0).sin(), 0.0);
        let camera_from_body = UnitQuaternion::from_euler_angles(
            -std::f64::consts::FRAC_PI_2,
            0.0,
            -std::f64::consts::FRAC_PI_2,
        )
        .inverse();
        Pose::new(camera.rotation * camera_from_body, camera.translation)
    }
}

/// A candidate with ten times as many votes as inliers.
pub fn candidate(keyframe: KeyframeId, inliers: u32, verdict: CandidateVerdict) -> ViewedCandidate {
    ViewedCandidate {
        keyframe,
        near_prior: false,
        votes: 10 * inliers,
        matches: 2 * inliers,
        inliers,
        mean_error_px: Some(1.25),
        verdict,
    }
}

/// A query whose image was recognized in some keyframes, or for none was not.
pub fn answered(keyframes: &[KeyframeId], candidates: Vec<ViewedCandidate>) -> ViewedQuery {
    let outcome = if keyframes.is_empty() { MatchOutcome::NotVerified } else { MatchOutcome::Matched };
    let result = ViewedResult::Answered(Box::new(ViewedAnswer {
        outcome,
        map_version: 3,
        stamp_ns: Some(12),
        features: 400,
        keyframes: keyframes.to_vec(),
        prior_in_global: Some([8.0, 0.0, 1.0]),
        camera_in_global: None,
        fix: None,
        candidates,
    }));
    ViewedQuery { kind: "match", map: "place".to_owned(), duration_ms: 14.5, result }
}

fn reason(state: RobotState) -> &'static str {
    match state {
        RobotState::Localized => "the map was last used 0.4 s ago",
        RobotState::OdometryOnly => "no answer from the map for 12.5 s",
        RobotState::Starting => "at rest for 0.2 s, 0.5 s are needed",
        RobotState::Off => "it was shut down",
        RobotState::Lost => "velocity sigma 1.2 m/s exceeds 1.0: was tracking lost?",
    }
}

/// The whole response to a request as bytes.
pub async fn response(address: SocketAddr, request: impl AsRef<[u8]>) -> Vec<u8> {
    let mut stream = TcpStream::connect(address).await.unwrap();
    stream.write_all(request.as_ref()).await.unwrap();
    let mut bytes = Vec::new();
    stream.read_to_end(&mut bytes).await.unwrap();
    bytes
}

pub async fn get(address: SocketAddr, path: &str) -> Vec<u8> {
    response(address, &format!("GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n")).await
}
