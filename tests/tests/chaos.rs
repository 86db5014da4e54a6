//! Servers, routers and links that fail at random while robots drive.
//!
//! ```sh
//! cargo test --release -p driftless-tests chaos -- --ignored --nocapture
//! ```
//! is the long run, on the recording `yq`; `ROUNDS`, `ROBOTS` and `SEED` in the environment change it.

use client::session::{SessionOptions, close_session, open_session};
use map_server::{MapServer, ServedMap, ServerOptions};
use mapping::{BuildOptions, build_map};
use onboard::{OpeningLink, Outcome, RobotLink, StopSignal, run_robot_until};
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};
use recognition::LoadedMap;
use sensors::Sequence;
use simulation::SimulationOptions;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use testing::resident_mb;
use tests::data::recording;
use tests::fleet::router;
use tests::link::{Condition, Link};
use tests::network::runtime;
use tests::robot::arguments;
use tests::scenario::MappedScenario;
use tokio::runtime::Runtime;
use tools::in_process::{LocalServer, free_endpoint};

const MAP: &str = "town";

/// A router, and a map server behind a link of its own.
struct Infrastructure {
    runtime: Runtime,
    map: Arc<LoadedMap>,
    router_at: String,
    server_link: Link,
    router: Option<zenoh::Session>,
    server: Option<(zenoh::Session, MapServer)>,
}

impl Infrastructure {
    fn start(map: Arc<LoadedMap>) -> Self {
        let runtime = runtime();
        let router_at = free_endpoint().unwrap();
        let server_link = Link::to(&router_at, runtime.handle());
        let mut this = Self { runtime, map, router_at, server_link, router: None, server: None };
        this.start_router();
        this.start_server();
        this
    }

    fn start_router(&mut self) {
        let options = router(&self.router_at, &[]);
        self.router = Some(self.runtime.block_on(open_session(&options)).unwrap());
    }

    fn stop_router(&mut self) {
        self.runtime.block_on(close_session(&self.router.take().unwrap()));
    }

    fn start_server(&mut self) {
        let connect = vec![self.server_link.endpoint().to_owned()];
        let options = SessionOptions { connect, ..SessionOptions::default() };
        let maps = vec![ServedMap { name: MAP.to_owned(), map: Arc::clone(&self.map) }];
        self.server = Some(self.runtime.block_on(async {
            let session = open_session(&options).await.unwrap();
            let server = MapServer::start(session.clone(), maps, ServerOptions::default()).await.unwrap();
            (session, server)
        }));
    }

    /// `is_told`: it says farewell; otherwise it is gone without a word.
    fn stop_server(&mut self, is_told: bool) {
        let (session, server) = self.server.take().unwrap();
        if !is_told {
            self.server_link.set(Condition::Cut);
        }
        self.runtime.block_on(async {
            server.stop().await.unwrap();
            close_session(&session).await;
        });
        self.server_link.set(Condition::Good);
    }

    /// Lets one thing fail for a while.
    fn fail(&mut self, rng: &mut StdRng) {
        match rng.random_range(0..4) {
            0 => {
                self.stop_router();
                pause(rng, 0.5, 4.0);
                self.start_router();
            }
            1 => {
                self.server_link.set(condition(rng));
                pause(rng, 1.0, 8.0);
                self.server_link.set(Condition::Good);
            }
            which => {
                self.stop_server(which == 2);
                pause(rng, 0.5, 4.0);
                self.start_server();
            }
        }
    }
}

fn pause(rng: &mut StdRng, from_s: f64, to_s: f64) {
    std::thread::sleep(Duration::from_secs_f64(rng.random_range(from_s..to_s)));
}

fn condition(rng: &mut StdRng) -> Condition {
    match rng.random_range(0..4) {
        0 => Condition::Cut,
        1 => Condition::Silent,
        _ => {
            let delay = Duration::from_millis(rng.random_range(10..300));
            Condition::Slow { bytes_per_s: rng.random_range(20_000..500_000), delay }
        }
    }
}

/// Lets a link fail now and then.
fn trouble(link: &Link, is_over: &AtomicBool, seed: u64) {
    let mut rng = StdRng::seed_from_u64(seed);
    while !is_over.load(Ordering::Relaxed) {
        pause(&mut rng, 4.0, 20.0);
        link.set(condition(&mut rng));
        pause(&mut rng, 1.0, 8.0);
        link.set(Condition::Good);
    }
}

fn drive(live: &Sequence, link: RobotLink, switches: &str) -> Outcome {
    let folder = tempfile::tempdir().unwrap();
    run_robot_until(&StopSignal::default(), live, &arguments(folder.path(), switches), Some(link), |_| {})
        .unwrap()
}

/// Robots that drive in real time through chaos, which ends some seconds before they do.
fn through_chaos(live: &Sequence, map: &Arc<LoadedMap>, robots: usize, seed: u64) -> Vec<Outcome> {
    let mut infrastructure = Infrastructure::start(Arc::clone(map));
    let handle = infrastructure.runtime.handle().clone();
    let links: Vec<Link> = (0..robots).map(|_| Link::to(&infrastructure.router_at, &handle)).collect();
    let is_over = AtomicBool::new(false);
    let begin = Instant::now();
    let stamps = (live.frames.first().unwrap().stamp_ns, live.frames.last().unwrap().stamp_ns);
    let duration = Duration::from_nanos(u64::try_from(stamps.1 - stamps.0).unwrap());
    let calm = begin + duration.saturating_sub(Duration::from_secs(15));
    std::thread::scope(|scope| {
        let driven: Vec<_> = (0..robots)
            .map(|robot| {
                let connect = vec![links[robot].endpoint().to_owned()];
                let options = SessionOptions { connect, ..SessionOptions::default() };
                let link = OpeningLink::open(options, handle.clone(), MAP).unwrap();
                let switches = format!("--realtime --robot r{robot}");
                scope.spawn(move || drive(live, RobotLink::Opening(link), &switches))
            })
            .collect();
        for (link, seed) in links.iter().zip(seed + 1..) {
            let is_over = &is_over;
            scope.spawn(move || trouble(link, is_over, seed));
        }
        let mut rng = StdRng::seed_from_u64(seed);
        let (mut failures, mut printed) = (0, begin);
        while Instant::now() < calm {
            pause(&mut rng, 3.0, 15.0);
            infrastructure.fail(&mut rng);
            failures += 1;
            if printed.elapsed() > Duration::from_mins(2) {
                printed = Instant::now();
                println!(
                    "{:.0} s: {failures} failures, {:.0?} MB",
                    begin.elapsed().as_secs_f64(),
                    resident_mb(std::process::id())
                );
            }
        }
        is_over.store(true, Ordering::Relaxed);
        println!("{failures} failures of router and server in {:.0} s", begin.elapsed().as_secs_f64());
        driven.into_iter().map(|robot| robot.join().unwrap()).collect()
    })
}

/// A robot whose network is never in trouble.
fn undisturbed(live: &Sequence, map: &Arc<LoadedMap>) -> Outcome {
    let server = LocalServer::start(vec![(MAP.to_owned(), Arc::clone(map))]).unwrap();
    let link = server.link(MAP).unwrap();
    let outcome = drive(live, RobotLink::Open(link.clone()), "");
    server.unlink(&link);
    server.stop().unwrap();
    outcome
}

/// RMSE and NEES of the pose in G.
fn pose(outcome: &Outcome) -> (f64, f64) {
    let pose = outcome.summary.score.as_ref().unwrap().pose.unwrap();
    (pose.rmse_m, pose.nees_pose.unwrap())
}

/// Asserts that nobody was lost, and that errors and NEES stay within bounds.
fn assert_unharmed(quiet: &Outcome, robots: &[Outcome], ratio: f64, nees: f64) {
    let calm = pose(quiet);
    println!("quiet: {:.4} m, NEES {:.2}, {} accepted", calm.0, calm.1, quiet.summary.queries.accepted);
    for (robot, outcome) in robots.iter().enumerate() {
        let (queries, now) = (&outcome.summary.queries, pose(outcome));
        println!(
            "robot {robot}: {:.4} m, NEES {:.2}, {} accepted, {} failed",
            now.0, now.1, queries.accepted, queries.failed
        );
        assert_eq!(outcome.summary.ended_early, None);
        assert_eq!(outcome.summary.reinitializations, 0);
        assert!(queries.accepted > 0 && queries.failed > 0, "nothing failed, or everything");
        assert!(now.0 <= ratio * calm.0 && now.1 < nees, "robot {robot}: {now:?}, quiet {calm:?}");
    }
}

#[test]
fn robots_drive_on_while_the_network_fails() {
    drive_on_while_the_network_fails(2);
}

#[test]
#[ignore = "more robots"]
fn three_robots_drive_on_while_the_network_fails() {
    drive_on_while_the_network_fails(3);
}

fn drive_on_while_the_network_fails(robots: usize) {
    let scenario = MappedScenario::of(&SimulationOptions {
        seed: 3,
        max_tracks: 50,
        duration_s: Some(60.0),
        ..SimulationOptions::default()
    });
    let (live, map) = (&scenario.recordings.live, scenario.loaded());
    let robots = through_chaos(live, &map, robots, 1);
    // A minute, of which an outage takes a larger part than of a long drive.
    assert_unharmed(&undisturbed(live, &map), &robots, 3.0, 2.0);
}

#[test]
#[ignore = "takes as long as the recording: 17 minutes a round"]
fn chaos_on_a_long_drive() {
    let setting =
        |name: &str, default: u64| std::env::var(name).map_or(default, |text| text.parse().unwrap());
    let mapped = Sequence::open(&recording("yq/map")).unwrap();
    let references = mapped.reference_poses.clone().unwrap();
    let built = build_map(&mapped, &references, None, &BuildOptions::default(), &mut |_, _, _| {});
    let map = Arc::new(LoadedMap::from_contents(built.unwrap().0).unwrap());
    let live = Sequence::open(&recording("yq/live")).unwrap();
    let quiet = undisturbed(&live, &map);
    for round in 0..setting("ROUNDS", 2) {
        println!("round {round}");
        let robots =
            through_chaos(&live, &map, setting("ROBOTS", 5) as usize, setting("SEED", 1) + 100 * round);
        assert_unharmed(&quiet, &robots, 1.5, 1.5);
    }
}
