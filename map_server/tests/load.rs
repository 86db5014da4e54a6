//! A fleet's load on one server, measured: not a check, so it runs only when asked for.
//!
//! ```sh
//! cargo test --release -p driftless-map-server --test load -- --ignored --nocapture
//! ```
//! `ROBOTS=100 SECONDS=600 KEYFRAMES=1000` in the environment change what is measured. Where `taskset` is installed, the
//! server runs on processor 0 and the robots on the others.
#![cfg(unix)]
#![allow(clippy::unwrap_used, missing_docs)]

use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use client::{ClientError, MapClient, SessionOptions, close_session, open_session};
use geometry::PoseWithCovariance;
use geometry::uncertain_pose::isotropic_covariance;
use map::store;
use protocol::{MatchRequest, PosePrior};
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};
use testing::{Place, PlaceOptions};

/// Time that a robot waits for an answer.
const DEADLINE: Duration = Duration::from_secs(2);
/// Time between two queries of one robot.
const PERIOD: Duration = Duration::from_secs(1);
/// One robot of so many has no prior.
const WITHOUT_PRIOR: usize = 10;

fn setting(name: &str, default: usize) -> usize {
    std::env::var(name).map_or(default, |text| text.parse().unwrap())
}

/// Ends the server whatever happens.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn start_server(arguments: &[&str]) -> Running {
    let program = env!("CARGO_BIN_EXE_map_server");
    let has_taskset = Command::new("taskset").arg("-V").stdout(Stdio::null()).status().is_ok();
    let mut command = if has_taskset {
        let mut command = Command::new("taskset");
        command.args(["-c", "0", program]);
        command
    } else {
        Command::new(program)
    };
    Running(command.args(arguments).args(["--workers", "1"]).spawn().unwrap())
}

/// Requests from places along the path of a map; `has_prior` states the pose to 0.3 m and 3 deg.
fn requests(place: &Place, has_prior: bool, seed: u64) -> Vec<MatchRequest> {
    let mut rng = StdRng::seed_from_u64(seed);
    let mut from_somewhere = || {
        let pose = place.path[rng.random_range(0..place.path.len())];
        let mut request = place.request(&pose, 4, &mut rng);
        let covariance = isotropic_covariance(0.05, 0.3);
        request.prior =
            has_prior.then(|| PosePrior { global_from_camera: PoseWithCovariance::new(pose, covariance) });
        request
    };
    (0..20).map(|_| from_somewhere()).collect()
}

/// What one robot saw.
#[derive(Default)]
struct Seen {
    latencies: Vec<Duration>,
    busy: usize,
    failed: usize,
}

async fn drive(endpoint: String, requests: Vec<MatchRequest>, first: Instant, end: Instant) -> Seen {
    let options = SessionOptions { connect: vec![endpoint], ..SessionOptions::default() };
    let session = open_session(&options).await.unwrap();
    let client = MapClient::new(session.clone(), "town").unwrap().awaiting_map();
    let mut seen = Seen::default();
    let mut due = first;
    for request in requests.iter().cycle() {
        if due >= end {
            break;
        }
        tokio::time::sleep_until(due.into()).await;
        let asked = Instant::now();
        match client.match_image(request, asked + DEADLINE).await {
            Ok(_) => seen.latencies.push(asked.elapsed()),
            Err(ClientError::Refused(_)) => seen.busy += 1,
            Err(_) => seen.failed += 1,
        }
        due = (due + PERIOD).max(Instant::now());
    }
    close_session(&session).await;
    seen
}

fn quantile(sorted: &[Duration], part: f64) -> f64 {
    let index = ((sorted.len() as f64 * part) as usize).min(sorted.len().saturating_sub(1));
    sorted.get(index).map_or(f64::NAN, |duration| duration.as_secs_f64() * 1e3)
}

#[test]
#[ignore = "a measurement of a minute or more"]
fn latencies_of_a_fleet() {
    let (robots, seconds, keyframes) =
        (setting("ROBOTS", 100), setting("SECONDS", 60), setting("KEYFRAMES", 1000));
    let options = PlaceOptions { keyframes, landmarks: 50 * keyframes, ..PlaceOptions::default() };
    let place = Place::new(&options);
    let folder = tempfile::tempdir().unwrap();
    let database = folder.path().join("town.db");
    store::save_map(&database, &place.map, false).unwrap();
    let endpoint = format!("tcp/127.0.0.1:{}", setting("PORT", 17_447));
    let map = format!("town={}", database.display());
    let server = start_server(&["--map", &map, "--listen", &endpoint]);

    let runtime = tokio::runtime::Runtime::new().unwrap();
    // The server loads its map, and all robots connect.
    let begin = Instant::now() + Duration::from_secs(20);
    let end = begin + Duration::from_secs(seconds as u64);
    let tasks: Vec<_> = (0..robots)
        .map(|k| {
            let requests = requests(&place, k % WITHOUT_PRIOR != 0, k as u64);
            let first = begin + PERIOD.mul_f64(k as f64 / robots as f64);
            runtime.spawn(drive(endpoint.clone(), requests, first, end))
        })
        .collect();
    let mut seen: Vec<Seen> = tasks.into_iter().map(|task| runtime.block_on(task).unwrap()).collect();
    drop(server);

    let mut medians = Vec::new();
    for robot in &mut seen {
        robot.latencies.sort();
        medians.push(quantile(&robot.latencies, 0.5));
    }
    let mut all: Vec<Duration> = seen.iter().flat_map(|robot| robot.latencies.iter().copied()).collect();
    all.sort();
    medians.sort_by(f64::total_cmp);
    let total = |count: fn(&Seen) -> usize| seen.iter().map(count).sum::<usize>();
    println!(
        "{robots} robots, {seconds} s, {keyframes} keyframes: {} answers, {} busy, {} failed; p50 {:.1} ms, p99 {:.1} ms; medians of robots {:.1} to {:.1} ms",
        all.len(),
        total(|robot| robot.busy),
        total(|robot| robot.failed),
        quantile(&all, 0.5),
        quantile(&all, 0.99),
        medians[0],
        medians[medians.len() - 1],
    );
    assert!(!all.is_empty(), "no answer at all");
}
