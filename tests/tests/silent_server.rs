//! A map server that takes queries and does not answer them, as one whose machine swaps, and answers again later.

use client::session::{SessionOptions, close_session, open_session};
use map_server::{MapServer, ServedMap, ServerOptions};
use onboard::{OpeningLink, RobotLink, StopSignal, run_robot_until};
use protocol::keys;
use simulation::SimulationOptions;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tests::network::runtime;
use tests::robot::arguments;
use tests::scenario::MappedScenario;
use tools::in_process::free_endpoint;

const MAP: &str = "town";
/// How long queries are held: many times their deadline.
const SILENCE: Duration = Duration::from_secs(8);
/// Time of the sensors from the recovery of the server to the next query that it answers.
const BACK: i64 = 10_000_000_000;

#[test]
fn a_robot_asks_again_soon_after_its_server_recovered() {
    let simulation = SimulationOptions { seed: 3, duration_s: Some(26.0), ..SimulationOptions::default() };
    let scenario = MappedScenario::of(&simulation);
    let (live, map) = (&scenario.recordings.live, scenario.loaded());
    let runtime = runtime();
    let endpoint = free_endpoint().unwrap();
    let options = SessionOptions { listen: vec![endpoint.clone()], ..SessionOptions::default() };
    let session = runtime.block_on(open_session(&options)).unwrap();
    let held = Arc::new(Mutex::new(Vec::new()));
    let holding = Arc::clone(&held);
    let key = keys::map_match(MAP).unwrap();
    let silent = session.declare_queryable(key).callback(move |query| holding.lock().unwrap().push(query));
    let silent = runtime.block_on(async { silent.await }).unwrap();

    let options = SessionOptions { connect: vec![endpoint], ..SessionOptions::default() };
    let link = OpeningLink::open(options, runtime.handle().clone(), MAP).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let arguments = arguments(folder.path(), "--realtime --deadline 0.3");
    let (frame, recovered) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let (outcome, server) = std::thread::scope(|scope| {
        let driving = scope.spawn(|| {
            let stop = StopSignal::default();
            let progress = |at| frame.store(at, Ordering::Relaxed);
            run_robot_until(&stop, live, &arguments, Some(RobotLink::Opening(link)), progress).unwrap()
        });
        while held.lock().unwrap().is_empty() {
            assert!(!driving.is_finished(), "it never asked");
            std::thread::sleep(Duration::from_millis(20));
        }
        std::thread::sleep(SILENCE);
        let server = runtime.block_on(async {
            silent.undeclare().await.unwrap();
            let maps = vec![ServedMap { name: MAP.to_owned(), map }];
            MapServer::start(session.clone(), maps, ServerOptions::default()).await.unwrap()
        });
        recovered.store(frame.load(Ordering::Relaxed), Ordering::Relaxed);
        (driving.join().unwrap(), server)
    });

    assert_eq!(outcome.summary.ended_early, None);
    let events = outcome.events().unwrap();
    let failed = events.iter().filter(|event| event.outcome == "failed").count();
    assert!(failed >= 4, "{failed} queries ended without an answer");
    let recovered_ns = live.frames[recovered.into_inner()].stamp_ns;
    let answered = events.iter().find(|event| event.stamp_ns > recovered_ns && event.outcome != "failed");
    let after = answered.expect("no query was answered").stamp_ns - recovered_ns;
    println!("{failed} failed, then answered {:.1} s after the recovery", after as f64 * 1e-9);
    assert!(after < BACK, "{after} ns");
    assert!(outcome.summary.queries.accepted > 0);
    drop(held);
    runtime.block_on(server.stop()).unwrap();
    runtime.block_on(close_session(&session));
}
