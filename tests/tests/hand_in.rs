//! Sessions that are handed in over a network: slow, cut, damaged by a server that starts again.

use client::session::{SessionOptions, close_session, open_session};
use client::{MapClient, SessionUpload};
use hand_in::inbox::digest_of;
use hand_in::{Candidate, Chunk, Header, Inbox, InboxSettings, Session, SessionFrame, SessionWriter};
use map_server::InboxService;
use protocol::{DescriptorKind, Descriptors, FeatureSet};
use sensors::{CameraSensor, ImuNoise, ImuSensor};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use tests::link::{Condition, Link};
use tests::network;
use tokio::runtime::Runtime;
use tools::in_process::free_endpoint;

/// A server that takes sessions of the map `hall`.
struct Server {
    session: zenoh::Session,
    inbox: InboxService,
}

impl Server {
    fn start(runtime: &Runtime, endpoint: &str, folder: &Path) -> Self {
        let options = SessionOptions { listen: vec![endpoint.to_owned()], ..SessionOptions::default() };
        let session = runtime.block_on(open_session(&options)).unwrap();
        let settings = InboxSettings {
            folder: folder.to_owned(),
            bytes_of_robot: 1 << 20,
            bytes_in_all: 1 << 20,
            keys: None,
        };
        let inbox = Inbox::open(settings).unwrap();
        let inbox = runtime.block_on(InboxService::start(&session, ["hall"], inbox)).unwrap();
        Self { session, inbox }
    }

    fn stop(self, runtime: &Runtime) {
        runtime.block_on(self.inbox.stop()).unwrap();
        runtime.block_on(close_session(&self.session));
    }
}

/// A session of about so many bytes.
fn session(path: &Path, bytes: usize) -> Vec<u8> {
    let camera = geometry::Camera {
        width: 640,
        height: 480,
        focal: [400.0; 2],
        centre: [320.0, 240.0],
        distortion: geometry::Distortion::None,
    };
    let imu =
        ImuSensor { noise: ImuNoise::default(), rate_hz: 200.0, gravity_magnitude: None, intrinsics: None };
    let header = Header {
        robot: "ada".to_owned(),
        name: "ada_1".to_owned(),
        program: "test".to_owned(),
        started_unix_s: 0,
        imu,
        cameras: vec![CameraSensor::new(camera, geometry::Pose::identity(), 20.0)],
    };
    let features = |at: usize| FeatureSet {
        pixels: vec![[at as f32, 7.0]; 100],
        descriptors: Descriptors { kind: DescriptorKind::Binary, width: 32, bytes: vec![at as u8; 3200] },
        extractor: "test-1".to_owned(),
    };
    let frames = (0..bytes / 3400).map(|at| SessionFrame {
        stamp_ns: at as i64 * 1_000_000_000,
        tracks: Vec::new(),
        candidates: vec![Candidate { camera: 0, features: features(at) }],
    });
    let mut writer = SessionWriter::create(path, &header).unwrap();
    writer.append(&Chunk { frames: frames.collect(), ..Chunk::default() }).unwrap();
    writer.finish().unwrap();
    std::fs::read(path).unwrap()
}

fn upload(bytes: &[u8], bytes_per_second: f64) -> SessionUpload<'_> {
    let digest = digest_of(bytes);
    SessionUpload { robot: "ada", digest, bytes, bytes_per_second, patience: Duration::from_secs(20) }
}

fn client(runtime: &Runtime, endpoint: &str) -> (zenoh::Session, MapClient) {
    let options = SessionOptions { connect: vec![endpoint.to_owned()], ..SessionOptions::default() };
    let session = runtime.block_on(open_session(&options)).unwrap();
    let client = MapClient::new(session.clone(), "hall").unwrap();
    (session, client)
}

/// The files of an inbox.
fn files(folder: &Path) -> Vec<PathBuf> {
    let of_robot = folder.join("ada");
    if !of_robot.exists() {
        return Vec::new();
    }
    std::fs::read_dir(of_robot).unwrap().map(|entry| entry.unwrap().path()).collect()
}

#[test]
fn a_link_of_a_megabit_that_is_lost_again_and_again_is_used_by_a_tenth_and_the_session_is_whole() {
    let (runtime, folder) = (network::runtime(), tempfile::tempdir().unwrap());
    let inbox = folder.path().join("inbox");
    let endpoint = free_endpoint().unwrap();
    let server = Server::start(&runtime, &endpoint, &inbox);
    let link = Link::to(&endpoint, runtime.handle());
    let slow = Condition::Slow { bytes_per_s: 125_000, delay: Duration::from_millis(20) };
    link.set(slow);
    let (session_of_client, client) = client(&runtime, link.endpoint());
    let bytes = session(&folder.path().join("a.session"), 60_000);
    let rate = 11_250.0;
    let begin = Instant::now();
    let handing_in = {
        let (bytes, client) = (bytes.clone(), client.clone());
        runtime.spawn(async move { client.hand_in(&upload(&bytes, rate), |_| {}).await })
    };
    for condition in [Condition::Cut, Condition::Cut] {
        std::thread::sleep(Duration::from_millis(1500));
        link.set(condition);
        std::thread::sleep(Duration::from_millis(700));
        link.set(slow);
    }
    runtime.block_on(handing_in).unwrap().unwrap();
    let seconds = begin.elapsed().as_secs_f64();
    assert!(bytes.len() as f64 / seconds < 12_500.0, "{} bytes in {seconds} s", bytes.len());
    let found = files(&inbox);
    assert_eq!(found.len(), 1);
    assert_eq!(std::fs::read(&found[0]).unwrap(), bytes);
    assert_eq!(Session::open(&found[0]).unwrap().header.robot, "ada");
    runtime.block_on(close_session(&session_of_client));
    server.stop(&runtime);
}

#[test]
fn a_server_that_starts_again_goes_on_where_it_was_and_a_robot_too() {
    let (runtime, folder) = (network::runtime(), tempfile::tempdir().unwrap());
    let inbox = folder.path().join("inbox");
    let endpoint = free_endpoint().unwrap();
    let bytes = session(&folder.path().join("a.session"), 200_000);
    let server = Server::start(&runtime, &endpoint, &inbox);
    let (session_of_client, client) = client(&runtime, &endpoint);
    // A robot that is stopped in the middle.
    let begun = runtime.block_on(async {
        let upload = upload(&bytes, 40_000.0);
        tokio::time::timeout(Duration::from_millis(2500), client.hand_in(&upload, |_| {})).await
    });
    assert!(begun.is_err(), "it was not stopped in the middle");
    server.stop(&runtime);
    let received = files(&inbox)[0].metadata().unwrap().len();
    assert!(received > 0 && received < bytes.len() as u64, "{received}");
    let server = Server::start(&runtime, &endpoint, &inbox);
    let mut first = None;
    let upload = upload(&bytes, 1e6);
    runtime
        .block_on(client.hand_in(&upload, |bytes| {
            first.get_or_insert(bytes);
        }))
        .unwrap();
    assert!(first.unwrap() >= received, "{first:?} of {received}");
    assert_eq!(std::fs::read(&files(&inbox)[0]).unwrap(), bytes);
    // Again: it is there.
    let begin = Instant::now();
    runtime.block_on(client.hand_in(&SessionUpload { bytes_per_second: 100.0, ..upload }, |_| {})).unwrap();
    assert!(begin.elapsed() < Duration::from_secs(10));
    // Another robot cannot hand it in, and is told so.
    let stolen = SessionUpload { robot: "eve", ..upload };
    let refusal = runtime.block_on(client.hand_in(&stolen, |_| {})).unwrap_err().to_string();
    assert!(refusal.contains("\"ada\"") && refusal.contains("\"eve\""), "{refusal}");
    runtime.block_on(close_session(&session_of_client));
    server.stop(&runtime);
}
