//! What the live map costs: the first picture of a large map, and what viewers take from robots.
//!
//! `KEYFRAMES=10000 LANDMARKS=3000000` in the environment change the large map, `VIEWERS=20 ROBOTS=10 SECONDS=30 ROUNDS=3` the load.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use axum::Router;
use client::{MapClient, SessionOptions, close_session, open_session};
use futures_util::StreamExt as _;
use geometry::uncertain_pose::isotropic_covariance;
use geometry::{Pose, PoseWithCovariance};
use map::{Keyframe, Landmark, MapContents, MapMetadata, Observation};
use map_server::{MapServer, ServedMap, ServerOptions, Show};
use nalgebra::{UnitQuaternion, Vector3};
use protocol::{
    DescriptorKind, Format, MapIdentity, Message, RobotOdometry, RobotPose, RobotState, RobotStatus, keys,
};
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};
use recognition::{LoadedMap, RecognitionOptions};
use testing::{DESCRIPTOR_BYTES, descriptor, resident_mb};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio_tungstenite::connect_async;
use zenoh::Session;

use crate::load::town::{MAP, Server, quantile_ms, requests, setting, town};

/// What the page asks for before it draws.
const FIRST_PICTURE: [&str; 4] =
    ["/api/maps", "/api/maps/city/keyframes", "/api/maps/city/landmarks?limit=1000000", "/api/live"];

/// Keyframes in a square, each with landmarks around it.
fn city(keyframes: usize, landmarks: usize) -> MapContents {
    let mut rng = StdRng::seed_from_u64(1);
    let mut map =
        MapContents::empty(MapMetadata::new("city", "test", DescriptorKind::Binary, DESCRIPTOR_BYTES as u16));
    let side = (keyframes as f64).sqrt();
    for at in 0..keyframes {
        let id = at as u64;
        let position = Vector3::new(2.0 * (at as f64 % side), 2.0 * (at as f64 / side).floor(), rng.random());
        let rotation = UnitQuaternion::from_euler_angles(rng.random(), rng.random(), rng.random());
        map.keyframes.push(Keyframe {
            id,
            stamp_ns: at as i64,
            global_from_keyframe: PoseWithCovariance::new(
                Pose::new(rotation, position),
                isotropic_covariance(0.003, rng.random_range(0.01..0.05)),
            ),
            camera: testing::camera(),
            features: None,
        });
        let per_keyframe = (landmarks * (at + 1)) / keyframes - (landmarks * at) / keyframes;
        for of_keyframe in 0..per_keyframe {
            let pixel = [rng.random_range(1.0..750.0), rng.random_range(1.0..478.0)];
            map.landmarks.push(Landmark {
                id: 1_000_000 * id + of_keyframe as u64,
                anchor: id,
                position_in_anchor: Vector3::new(
                    rng.random_range(-3.0..3.0),
                    rng.random_range(-2.0..2.0),
                    rng.random_range(2.0..12.0),
                ),
                observations: vec![Observation { keyframe: id, pixel, descriptor: descriptor(&mut rng) }],
            });
        }
    }
    map
}

/// Bytes of the whole response.
async fn fetch(address: std::net::SocketAddr, path: &str) -> usize {
    let mut stream = TcpStream::connect(address).await.unwrap();
    let request = format!("GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n");
    stream.write_all(request.as_bytes()).await.unwrap();
    let mut response = Vec::new();
    stream.read_to_end(&mut response).await.unwrap();
    assert!(response.starts_with(b"HTTP/1.1 200"), "{path}");
    response.len()
}

#[test]
#[ignore = "a measurement of a minute or more"]
fn first_picture_of_a_city() {
    let (keyframes, landmarks) = (setting("KEYFRAMES", 10_000), setting("LANDMARKS", 3_000_000));
    let resident = || resident_mb(std::process::id()).unwrap();
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let begin = Instant::now();
    let map = Arc::new(LoadedMap::from_contents(city(keyframes, landmarks)).unwrap());
    println!("{keyframes} keyframes, {landmarks} landmarks: made in {:.1} s", begin.elapsed().as_secs_f64());
    runtime.block_on(async {
        let session = open_session(&SessionOptions::default()).await.unwrap();
        let served = ServedMap { name: "city".to_owned(), map };
        let server = MapServer::start(session.clone(), vec![served], ServerOptions::default()).await.unwrap();
        tokio::time::sleep(Duration::from_secs(1)).await;
        let before = resident();
        let begin = Instant::now();
        let names = ["city"].into_iter();
        let show =
            Show::start(([127, 0, 0, 1], 0).into(), &session, &server, names, Router::new()).await.unwrap();
        let started_ms = begin.elapsed().as_secs_f64() * 1e3;
        let after = resident();
        println!(
            "server: {before:.0} MB, with the page {after:.0} MB, {:.1} % more; it starts in {started_ms:.0} ms",
            100.0 * (after / before - 1.0)
        );
        let address = show.address();
        for round in 0..3 {
            let begin = Instant::now();
            let mut bytes = fetch(address, "/").await;
            for file in viewer::assets::ASSETS.iter().filter(|file| file.path.ends_with("js") || file.path.ends_with("css")) {
                bytes += fetch(address, &format!("/{}", file.path)).await;
            }
            let page = bytes;
            for path in &FIRST_PICTURE[..3] {
                let of_path = fetch(address, path).await;
                if round == 0 {
                    println!("{path}: {of_path} bytes");
                }
                bytes += of_path;
            }
            println!(
                "first picture: {:.2} MB ({:.2} MB of them the page), {:.0} ms",
                bytes as f64 * 1e-6,
                page as f64 * 1e-6,
                begin.elapsed().as_secs_f64() * 1e3
            );
        }
        println!("server after that: {:.0} MB", resident());
        if std::env::var("OPEN").is_ok() {
            println!("http://{address}");
            tokio::signal::ctrl_c().await.unwrap();
        }
        show.stop().await;
        server.stop().await.unwrap();
        close_session(&session).await;
    });
}

/// Robots that publish everything twenty times a second, until they are told to stop.
async fn publish(session: Session, robots: usize, is_over: Arc<AtomicBool>) {
    let mut ticks = tokio::time::interval(Duration::from_millis(50));
    let mut step = 0_i64;
    while !is_over.load(Ordering::Relaxed) {
        ticks.tick().await;
        step += 1;
        for robot in 0..robots {
            let name = format!("r{robot}");
            let x_m = 0.05 * (step as f64) + robot as f64;
            let pose = Pose::new(UnitQuaternion::identity(), Vector3::new(x_m, 0.3, 1.0));
            let uncertain = PoseWithCovariance::new(pose, isotropic_covariance(0.01, 0.1));
            let message = RobotPose {
                stamp_ns: step,
                map: MAP.to_owned(),
                map_version: 1,
                map_identity: MapIdentity::from_bytes([7; 16]),
                global_from_imu: uncertain,
                global_from_local: uncertain,
            };
            put(&session, keys::robot_pose(&name).unwrap(), &message).await;
            let message = RobotOdometry {
                stamp_ns: step,
                local_from_imu: uncertain,
                velocity_in_local: [1.0, 0.0, 0.0],
                angular_velocity_in_imu: [0.0; 3],
            };
            put(&session, keys::robot_odometry(&name).unwrap(), &message).await;
            let message = RobotStatus {
                stamp_ns: step,
                state: RobotState::Localized,
                reason: "the map was last used 0.4 s ago".to_owned(),
                map: Some(MAP.to_owned()),
                last_map_update_ns: Some(step),
                keyframes_held: 24,
                queries_sent: step as u64,
                queries_answered: step as u64,
            };
            put(&session, keys::robot_status(&name).unwrap(), &message).await;
        }
    }
}

async fn put<M: Message>(session: &Session, key: String, message: &M) {
    let payload = protocol::encode(Format::Json, message).unwrap();
    session.put(key, payload).encoding(Format::Json.encoding()).await.unwrap();
}

/// Pages that follow all robots and look for new queries each second.
struct Pages {
    tasks: Vec<tokio::task::JoinHandle<()>>,
    bytes: Arc<AtomicU64>,
}

impl Pages {
    async fn open(address: std::net::SocketAddr, count: usize) -> Self {
        let bytes = Arc::new(AtomicU64::new(0));
        let mut tasks = Vec::new();
        for _ in 0..count {
            let (mut socket, _) = connect_async(format!("ws://{address}/api/live")).await.unwrap();
            let received = Arc::clone(&bytes);
            tasks.push(tokio::spawn(async move {
                while let Some(Ok(message)) = socket.next().await {
                    received.fetch_add(message.len() as u64, Ordering::Relaxed);
                }
            }));
            tasks.push(tokio::spawn(async move {
                loop {
                    tokio::time::sleep(Duration::from_secs(1)).await;
                    fetch(address, "/api/queries?after=999999999&limit=512").await;
                }
            }));
        }
        Self { tasks, bytes }
    }

    fn close(self) -> u64 {
        self.tasks.iter().for_each(tokio::task::JoinHandle::abort);
        self.bytes.load(Ordering::Relaxed)
    }
}

/// Seconds of processor time that a process used.
fn processor_s(process: u32) -> f64 {
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).unwrap();
    let (_, fields) = stat.rsplit_once(')').unwrap();
    let fields: Vec<&str> = fields.split_whitespace().collect();
    // In hundredths on Linux.
    (fields[11].parse::<f64>().unwrap() + fields[12].parse::<f64>().unwrap()) / 100.0
}

#[test]
#[ignore = "a measurement of minutes"]
fn viewers_beside_robots() {
    let (viewers, robots) = (setting("VIEWERS", 20), setting("ROBOTS", 10));
    let (seconds, rounds) = (setting("SECONDS", 30), setting("ROUNDS", 3));
    let place = town(setting("KEYFRAMES", 1000));
    let folder = tempfile::tempdir().unwrap();
    let (port, http) = (setting("PORT", 17_451), setting("HTTP", 17_452));
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let address = std::net::SocketAddr::from(([127, 0, 0, 1], http as u16));
    let server =
        Server::start_with(&place, folder.path(), &endpoint, None, &["--http", &address.to_string()]);
    let runtime = tokio::runtime::Runtime::new().unwrap();
    runtime.block_on(async {
        let options = SessionOptions { connect: vec![endpoint], ..SessionOptions::default() };
        let session = open_session(&options).await.unwrap();
        let client = MapClient::new(session.clone(), MAP).unwrap().awaiting_map();
        let requests = requests(&place, true, 1);
        client.match_image(&requests[0], Instant::now() + Duration::from_mins(1)).await.unwrap();
        let is_over = Arc::new(AtomicBool::new(false));
        let publishing = tokio::spawn(publish(session.clone(), robots, Arc::clone(&is_over)));
        let mut all = [Vec::new(), Vec::new()];
        let mut used_s = [0.0, 0.0];
        for round in 0..rounds {
            // The order changes, so that neither is always first.
            for with in [round % 2, 1 - round % 2] {
                let pages = Pages::open(address, viewers * with).await;
                tokio::time::sleep(Duration::from_secs(2)).await;
                // Without queries, whose number depends on what else the machine does.
                let (begin, before) = (Instant::now(), processor_s(server.id()));
                tokio::time::sleep(Duration::from_secs(seconds as u64)).await;
                let share = (processor_s(server.id()) - before) / begin.elapsed().as_secs_f64();
                used_s[with] += share / rounds as f64;
                let (begin, mut at) = (Instant::now(), 0);
                while begin.elapsed() < Duration::from_secs(seconds as u64) {
                    let asked = Instant::now();
                    let request = &requests[at % requests.len()];
                    client.match_image(request, asked + Duration::from_secs(5)).await.unwrap();
                    all[with].push(asked.elapsed());
                    at += 1;
                    tokio::time::sleep(Duration::from_millis(40).saturating_sub(asked.elapsed())).await;
                }
                let sent = pages.close();
                println!(
                    "{} viewers: {:.1} % of a core without queries; {at} queries; {:.1} MB sent",
                    viewers * with,
                    100.0 * share,
                    sent as f64 * 1e-6
                );
            }
        }
        is_over.store(true, Ordering::Relaxed);
        publishing.await.unwrap();
        for latencies in &mut all {
            latencies.sort();
        }
        let [without, with] = &all;
        println!(
            "{robots} robots at 20 Hz; queries p50 {:.2} ms, p99 {:.2} ms without viewers, p50 {:.2} ms, p99 {:.2} ms with \
             {viewers}; the viewers take {:.1} % of a core",
            quantile_ms(without, 0.5),
            quantile_ms(without, 0.99),
            quantile_ms(with, 0.5),
            quantile_ms(with, 0.99),
            100.0 * (used_s[1] - used_s[0]),
        );
        close_session(&session).await;
    });
}

#[test]
#[ignore = "a measurement of a minute"]
fn what_a_report_costs() {
    let place = town(setting("KEYFRAMES", 1000));
    let map = LoadedMap::from_contents(place.map.clone()).unwrap();
    let options = RecognitionOptions::default();
    let requests = [requests(&place, true, 1), requests(&place, false, 2)].concat();
    let (sender, mut receiver) = tokio::sync::broadcast::channel(256);
    let viewer = viewer::Viewer::new();
    // [answered, told, kept]: seconds in all.
    let mut spent = [0.0_f64; 3];
    let rounds = setting("ROUNDS", 20);
    for _ in 0..rounds {
        for request in &requests {
            let begin = Instant::now();
            let (replies, search) = map.answer_with_report(request, &options).unwrap();
            spent[0] += begin.elapsed().as_secs_f64();
            drop(replies);
            // What a server does after its last reply, where somebody listens.
            let begin = Instant::now();
            sender.send((request.robot.clone(), MAP.to_owned(), search)).unwrap();
            spent[1] += begin.elapsed().as_secs_f64();
            // What the page's task does with it.
            let begin = Instant::now();
            let (robot, map, search) = receiver.try_recv().unwrap();
            let candidates = search.candidates.iter().map(|candidate| viewer::ViewedCandidate {
                keyframe: candidate.keyframe,
                near_prior: candidate.near_prior,
                votes: candidate.votes,
                matches: candidate.matches,
                inliers: candidate.inliers,
                mean_error_px: candidate.mean_error_px,
                verdict: viewer::CandidateVerdict::InAnswer,
            });
            let answer = viewer::ViewedAnswer {
                outcome: protocol::MatchOutcome::Matched,
                map_version: 1,
                stamp_ns: None,
                features: request.features.len(),
                keyframes: Vec::new(),
                prior_in_global: None,
                camera_in_global: search.camera_in_global().map(Into::into),
                fix: None,
                candidates: candidates.collect(),
            };
            let result = viewer::ViewedResult::Answered(Box::new(answer));
            viewer.note_query(&robot, viewer::ViewedQuery { kind: "match", map, duration_ms: 1.0, result });
            spent[2] += begin.elapsed().as_secs_f64();
        }
    }
    let count = (rounds * requests.len()) as f64;
    let [answered, told, kept] = spent.map(|seconds| 1e6 * seconds / count);
    println!("{count} queries: answered in {answered:.0} us, told in {told:.2} us, kept in {kept:.2} us");
}
