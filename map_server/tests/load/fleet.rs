//! A fleet's load on one server.
//!
//! `ROBOTS=100 SECONDS=600 KEYFRAMES=1000` in the environment change what is measured. Where `taskset` is installed, the
//! server runs on processor 0, or on the first of them with `PROCESSORS=2`. `LOSS=5` lets so many bursts of a hundred come late, as where packets
//! get lost, `COSTLIEST=1` adds so many clients that send the costliest requests, and `CHANGES=60` changes the map after each so many seconds.

use std::path::Path;
use std::process::{Child, Command};
use std::time::{Duration, Instant};

use crate::load::hostile::attack;
use crate::load::lossy::lossy;
use crate::load::town::{MAP, Server, quantile_ms, requests, setting, town};
use client::{ClientError, MapClient, SessionOptions, close_session, open_session};
use map::{MapContents, store};
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
    /// Longest time from one answer to the next.
    longest: Duration,
}

/// Ends the attackers with the measurement.
struct Attackers(Vec<Child>);

impl Drop for Attackers {
    fn drop(&mut self) {
        for attacker in &mut self.0 {
            let _ = attacker.kill();
            let _ = attacker.wait();
        }
    }
}

/// Moves a keyframe of the served map again and again, and has the server load the map.
///
/// In a fleet maps are written on another machine: on Linux, what is left of the processors writes them here.
fn change_map(database: &Path, mut map: MapContents, server: u32, period: Duration) {
    #[cfg(target_os = "linux")]
    rustix::process::setpriority_process(None, 19).unwrap();
    let mut due = Instant::now();
    loop {
        due += period;
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
        map.keyframes[0].global_from_keyframe.pose.translation.x += 0.01;
        store::save_map(database, &map, true).unwrap();
        let told = Command::new("kill").args(["-HUP", &server.to_string()]).status().unwrap();
        assert!(told.success(), "the server is gone");
    }
}

async fn drive(endpoint: String, requests: Vec<MatchRequest>, first: Instant, end: Instant) -> Seen {
    let options = SessionOptions { connect: vec![endpoint], ..SessionOptions::default() };
    let session = open_session(&options).await.unwrap();
    let client = MapClient::new(session.clone(), MAP).unwrap().awaiting_map();
    let mut seen = Seen::default();
    let (mut due, mut last) = (first, first);
    for request in requests.iter().cycle() {
        if due >= end {
            break;
        }
        tokio::time::sleep_until(due.into()).await;
        let asked = Instant::now();
        match client.match_image(request, asked + DEADLINE).await {
            Ok(_) => {
                seen.latencies.push(asked.elapsed());
                seen.longest = seen.longest.max(last.elapsed());
                last = Instant::now();
            }
            Err(ClientError::Refused(_)) => seen.busy += 1,
            Err(_) => seen.failed += 1,
        }
        due = (due + PERIOD).max(Instant::now());
    }
    seen.longest = seen.longest.max(last.elapsed());
    close_session(&session).await;
    seen
}

/// Memory of the server after a sixth of the time, and at the end, MB.
async fn watch_memory(server: &Server, begin: Instant, end: Instant) -> [f64; 2] {
    let mut memory = [f64::NAN; 2];
    for (at, when) in [begin + (end - begin) / 6, end].into_iter().enumerate() {
        tokio::time::sleep_until(when.into()).await;
        memory[at] = server.memory_mb()[0];
    }
    memory
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
    let (loss, attackers, changes) =
        (setting("LOSS", 0) as f64 / 100.0, setting("COSTLIEST", 0), setting("CHANGES", 0));
    // The server loads its map, and all robots connect.
    let begin = Instant::now() + Duration::from_secs(20);
    let end = begin + Duration::from_secs(seconds as u64);
    let tasks: Vec<_> = (0..robots)
        .map(|k| {
            let requests = requests(&place, k % WITHOUT_PRIOR != 0, k as u64);
            let first = begin + PERIOD.mul_f64(k as f64 / robots as f64);
            let endpoint = if loss > 0.0 {
                runtime.block_on(lossy(&endpoint, loss, k as u64))
            } else {
                endpoint.clone()
            };
            runtime.spawn(drive(endpoint, requests, first, end))
        })
        .collect();
    let _attackers = Attackers((0..attackers).map(|_| attack("costliest", &endpoint, "", 1)).collect());
    if changes > 0 {
        let database = Path::new(folder.path()).join("town.db");
        let period = Duration::from_secs(changes as u64);
        let (map, server) = (place.map.clone(), server.id());
        std::thread::spawn(move || change_map(&database, map, server, period));
    }
    let [early, late] = runtime.block_on(watch_memory(&server, begin, end));
    println!("server: {early:.0} MB after a sixth of the time, {late:.0} MB at the end");
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
    let longest = seen.iter().map(|robot| robot.longest).max().unwrap();
    println!("longest time of a robot without an answer: {:.1} s", longest.as_secs_f64());
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
