//! A fleet's load on one server.
//!
//! `ROBOTS=100 SECONDS=600 KEYFRAMES=1000` in the environment change what is measured. Where `taskset` is installed, the
//! server runs on processor 0 and the robots on the others.

use std::time::{Duration, Instant};

use crate::load::town::{MAP, Server, quantile_ms, requests, setting, town};
use client::{ClientError, MapClient, SessionOptions, close_session, open_session};
use protocol::MatchRequest;

/// Time that a robot waits for an answer.
const DEADLINE: Duration = Duration::from_secs(2);
/// Time between two queries of one robot.
const PERIOD: Duration = Duration::from_secs(1);
/// One robot of so many has no prior.
const WITHOUT_PRIOR: usize = 10;

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
    let client = MapClient::new(session.clone(), MAP).unwrap().awaiting_map();
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

#[test]
#[ignore = "a measurement of a minute or more"]
fn latencies_of_a_fleet() {
    let (robots, seconds, keyframes) =
        (setting("ROBOTS", 100), setting("SECONDS", 60), setting("KEYFRAMES", 1000));
    let place = town(keyframes);
    let folder = tempfile::tempdir().unwrap();
    let endpoint = format!("tcp/127.0.0.1:{}", setting("PORT", 17_447));
    let server = Server::start(&place, folder.path(), &endpoint, None);

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
    let [memory, peak] = server.memory_mb();
    println!("server: {memory:.0} MB, {peak:.0} MB at the peak");
    drop(server);

    let mut medians = Vec::new();
    for robot in &mut seen {
        robot.latencies.sort();
        medians.push(quantile_ms(&robot.latencies, 0.5));
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
        quantile_ms(&all, 0.5),
        quantile_ms(&all, 0.99),
        medians[0],
        medians[medians.len() - 1],
    );
    assert!(!all.is_empty(), "no answer at all");
}
