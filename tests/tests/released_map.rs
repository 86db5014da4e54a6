//! Robots drive while the map that they are in is released, rolled back, and its store fails.

use std::path::{Path, PathBuf};
use std::sync::Barrier;
use std::time::{Duration, Instant};

use client::session::{SessionOptions, close_session, open_session};
use estimator::Localization;
use map::MapContents;
use map::edit::{keyframes_where, remove_keyframes};
use map_server::{CellService, CellServiceOptions, MapServer, ServerOptions};
use onboard::{Outcome, run_robot};
use releases::{Note, Outcome as Publication, PublishOptions, Release, ReleaseStore, publish, roll_back};
use sensors::Sequence;
use tests::fleet::router;
use tests::network;
use tests::robot::arguments;
use tests::scenario::MappedScenario;
use tests::server::Client;
use tools::in_process::free_endpoint;

/// Places, each with its map, whose errors are independent of those of the others.
const PLACES: u64 = 5;
/// Robots in each place.
const ROBOTS: usize = 2;
const SERVERS: [&str; 3] = ["north", "south", "west"];
/// Frames at which all robots wait for each other and then go on, while a release comes, is rolled back, and the store fails; at
/// the last one they wait until that is over.
const PHASES: [usize; 4] = [90, 150, 210, 270];
/// Between two looks for a release.
const WATCH: Duration = Duration::from_millis(200);

/// A place, its map, and where that is released.
struct Released {
    name: String,
    scenario: MappedScenario,
    city: PathBuf,
    first: Release,
}

struct CellServer {
    session: zenoh::Session,
    server: MapServer,
    services: Vec<CellService>,
}

impl CellServer {
    async fn start(endpoint: &str, name: &str, places: &[Released], folder: &Path) -> Self {
        let options = SessionOptions { connect: vec![endpoint.to_owned()], ..SessionOptions::default() };
        let session = open_session(&options).await.unwrap();
        let mut options = ServerOptions::default();
        options.name = Some(name.to_owned());
        // The smallest bound: a cell is in memory while it is asked, and on disk else.
        options.cell_memory = (name == "west").then_some(1);
        let server = MapServer::start(session.clone(), Vec::new(), options).await.unwrap();
        let mut services = Vec::new();
        for Released { name: place, city, .. } in places {
            let mut options = CellServiceOptions::new(folder.join(name).join(place));
            options.watch = WATCH;
            let store = ReleaseStore::open(city.to_str().unwrap()).unwrap();
            services.push(CellService::start(&server, place, store, options).await.unwrap());
        }
        Self { session, server, services }
    }

    async fn stop(self) {
        for service in self.services {
            service.stop().await;
        }
        self.server.stop().await.unwrap();
        close_session(&self.session).await;
    }
}

fn small_cells() -> PublishOptions {
    let mut options = PublishOptions::default();
    options.keyframes_a_cell = 15;
    options
}

/// Without every fourth keyframe.
fn thinned(map: &MapContents) -> MapContents {
    let mut next = map.clone();
    let removed = keyframes_where(&next, |keyframe| keyframe.id % 4 == 1);
    assert!(!removed.is_empty());
    remove_keyframes(&mut next, &removed);
    next
}

/// Mean NEES of the poses in the map, over 6, and their root mean square error (m).
fn consistency(outcome: &Outcome, live: &Sequence) -> (f64, f64) {
    let truth = live.groundtruth.as_ref().unwrap();
    let (mut nees, mut squared, mut count) = (0.0, 0.0, 0.0);
    for state in outcome.states().unwrap() {
        let Some(pose) = &state.global_from_imu else { continue };
        let row = truth.iter().min_by_key(|row| (row.stamp_ns - state.stamp_ns).abs()).unwrap();
        nees += pose.nees(&row.pose).unwrap() / 6.0;
        squared += (pose.pose.translation - row.pose.translation).norm_squared();
        count += 1.0;
    }
    (nees / count, f64::sqrt(squared / count))
}

/// What happens to the releases of a place while its robots drive.
struct Events<'a> {
    client: &'a Client,
    place: &'a Released,
    folder: &'a Path,
}

impl Events<'_> {
    fn version(&self) -> u64 {
        let map = client::MapClient::new(self.client.session.clone(), &self.place.name).unwrap();
        let deadline = Instant::now() + Duration::from_secs(20);
        self.client.runtime.block_on(map.info(deadline)).unwrap().version
    }

    fn wait_for_version(&self, version: u64) {
        let begin = Instant::now();
        while self.version() != version {
            assert!(begin.elapsed() < Duration::from_mins(1), "version {version} is not served");
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    fn release(&self) {
        let map = thinned(&self.place.scenario.map);
        let release = publish_to(self.client, &self.place.city, map);
        self.wait_for_version(release.map.version);
    }

    fn roll_back(&self) {
        let store = ReleaseStore::open(self.place.city.to_str().unwrap()).unwrap();
        let rolled = self
            .client
            .runtime
            .block_on(roll_back(&store, self.place.first.number, &Note::default()))
            .unwrap();
        let Publication::Published(published) = rolled else { panic!("nothing changed") };
        self.wait_for_version(published.release.map.version);
    }

    /// The store is away for some seconds, and comes back with a release that has a damaged segment, and with half of another
    /// release; nothing of that is served.
    fn fail(&self) {
        let served = self.version();
        let away = self.folder.join(format!("{}-away", self.place.name));
        std::fs::rename(&self.place.city, &away).unwrap();
        let next = publish_to(self.client, &away, thinned(&self.place.scenario.map));
        std::thread::sleep(5 * WATCH);
        let first = &self.place.first.cells;
        let is_new = |sha256: &&String| !first.iter().any(|cell| cell.segment.sha256 == **sha256);
        let damaged = next.cells.iter().map(|cell| &cell.segment.sha256).find(is_new).unwrap();
        // Its release before last had it: servers fetch it again, since they keep what they serve only.
        std::fs::write(away.join("segments").join(damaged), "something else").unwrap();
        std::fs::rename(&away, &self.place.city).unwrap();
        std::thread::sleep(5 * WATCH);
        let torn = self.place.city.join(format!("releases/{:020}.json", next.number + 1));
        std::fs::write(torn, "{\n  \"schema\": 2,\n").unwrap();
        std::thread::sleep(5 * WATCH);
        assert_eq!(self.version(), served);
    }
}

fn publish_to(client: &Client, place: &Path, map: MapContents) -> Release {
    let store = ReleaseStore::open(place.to_str().unwrap()).unwrap();
    let published = client.runtime.block_on(publish(&store, map, &small_cells(), |_| {})).unwrap();
    let Publication::Published(published) = published else { panic!("it is there already") };
    published.release
}

/// The robots of all places drive at the same time; at each of [`PHASES`] all wait for each other, and drive on while one of the
/// events happens.
fn drive(
    places: &[Released],
    endpoint: &str,
    folder: &Path,
    mut event: impl FnMut(usize),
) -> Vec<Vec<Outcome>> {
    let together = Barrier::new(places.len() * ROBOTS + 1);
    std::thread::scope(|scope| {
        let start = |place: usize, robot: usize| {
            let (released, together) = (&places[place], &together);
            scope.spawn(move || {
                let own = Client::open(&[], &[endpoint]);
                let name = format!("robot{place}{robot}");
                let switches = arguments(&folder.join(&name), &format!("--robot {name}"));
                let link = own.link(&released.name);
                let outcome = run_robot(&released.scenario.recordings.live, &switches, Some(link), |frame| {
                    if PHASES.contains(&frame) {
                        together.wait();
                    }
                });
                own.close();
                outcome.unwrap()
            })
        };
        let robots: Vec<Vec<_>> =
            (0..places.len()).map(|place| (0..ROBOTS).map(|robot| start(place, robot)).collect()).collect();
        for phase in 0..PHASES.len() {
            together.wait();
            event(phase);
        }
        robots
            .into_iter()
            .map(|robots| robots.into_iter().map(|robot| robot.join().unwrap()).collect())
            .collect()
    })
}

/// Asserts that a robot was localized throughout, and returns its NEES and error as [`consistency`].
fn assert_localized(outcome: &Outcome, live: &Sequence, changes: u64) -> (f64, f64) {
    let states = outcome.states().unwrap();
    let fix = states.iter().position(|state| state.global_from_imu.is_some()).unwrap();
    assert!(states[fix..].iter().all(|state| state.global_from_imu.is_some()), "a robot was lost");
    let last = outcome.summary.final_status.as_ref().unwrap().localization;
    assert_eq!(last, Localization::Localized);
    let seen = outcome.summary.map_changes;
    assert_eq!((seen.carried_over, seen.found_anew), (changes, 0));
    let accepted = |from: usize, to: usize| {
        let stamps = live.frames[from].stamp_ns..live.frames[to].stamp_ns;
        let events = outcome.events().unwrap();
        events.iter().filter(|event| event.accepted && stamps.contains(&event.stamp_ns)).count()
    };
    let accepted: Vec<usize> = PHASES.windows(2).map(|pair| accepted(pair[0], pair[1])).collect();
    assert!(accepted.iter().all(|count| *count > 3), "{accepted:?}");
    consistency(outcome, live)
}

/// The mean NEES and error over all robots.
fn scored(what: &str, outcomes: &[Vec<Outcome>], places: &[Released], changes: u64) -> f64 {
    let mut all = (0.0, 0.0);
    for (outcomes, place) in outcomes.iter().zip(places) {
        for outcome in outcomes {
            let (nees, error) = assert_localized(outcome, &place.scenario.recordings.live, changes);
            println!("{what}, {}: NEES {nees:.2}, {error:.3} m", place.name);
            all = (all.0 + nees, all.1 + error);
        }
    }
    let count = (places.len() * ROBOTS) as f64;
    println!("{what}: NEES {:.2}, {:.3} m", all.0 / count, all.1 / count);
    all.0 / count
}

/// Places whose maps are released, and the servers of their cells.
struct City {
    folder: tempfile::TempDir,
    endpoint: String,
    runtime: tokio::runtime::Runtime,
    hub: zenoh::Session,
    client: Client,
    places: Vec<Released>,
    servers: Vec<CellServer>,
}

impl City {
    /// Starts it, and waits until each cell is served twice.
    fn start(places: u64) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let endpoint = free_endpoint().unwrap();
        let runtime = network::runtime();
        let hub = runtime.block_on(open_session(&router(&endpoint, &[]))).unwrap();
        let client = Client::open(&[], &[&endpoint]);
        let place = |number: u64| {
            let scenario = MappedScenario::new(number + 1);
            let name = format!("ring{number}");
            let city = folder.path().join(format!("city{number}"));
            let first = publish_to(&client, &city, scenario.map.clone());
            assert!(first.cells.len() >= 3, "{} cells", first.cells.len());
            Released { name, scenario, city, first }
        };
        let places: Vec<Released> = (0..places).map(place).collect();
        let servers: Vec<CellServer> = runtime.block_on(async {
            let mut servers = Vec::new();
            for name in SERVERS {
                servers.push(CellServer::start(&endpoint, name, &places, folder.path()).await);
            }
            servers
        });
        let all = 2 * places.iter().map(|place| place.first.cells.len()).sum::<usize>();
        let served =
            || -> usize { servers.iter().map(|server| server.server.statistics().cells as usize).sum() };
        let begin = Instant::now();
        while served() < all {
            assert!(begin.elapsed() < Duration::from_mins(1), "{} of {all} cells are served", served());
            std::thread::sleep(Duration::from_millis(50));
        }
        Self { folder, endpoint, runtime, hub, client, places, servers }
    }

    /// Drives undisturbed, and returns the mean NEES.
    fn quiet(&self) -> f64 {
        let driven = drive(&self.places, &self.endpoint, &self.folder.path().join("quiet"), |_| {});
        scored("quiet", &driven, &self.places, 0)
    }

    fn stop(self) {
        for server in self.servers {
            let statistics = server.server.statistics();
            println!("{} cells, {} cold loads", statistics.cells, statistics.cold_loads);
            self.runtime.block_on(server.stop());
        }
        self.client.close();
        self.runtime.block_on(close_session(&self.hub));
    }
}

#[test]
fn robots_are_localized_by_the_cells_of_several_servers() {
    let city = City::start(1);
    let nees = city.quiet();
    assert!(nees < 2.0, "{nees}");
    city.stop();
}

#[test]
#[ignore = "ten robots, twice: a minute"]
fn ten_robots_stay_localized_through_a_release_a_rollback_and_faults_of_the_store() {
    let city = City::start(PLACES);
    let quiet = city.quiet();
    let City { folder, endpoint, client, places, .. } = &city;
    let disturbed = drive(places, endpoint, &folder.path().join("disturbed"), |phase| {
        for place in places {
            let events = Events { client, place, folder: folder.path() };
            match phase {
                0 => events.release(),
                1 => events.roll_back(),
                2 => events.fail(),
                _ => {}
            }
        }
    });
    let disturbed = scored("disturbed", &disturbed, places, 2);
    println!("NEES {quiet:.2} and {disturbed:.2}");
    assert!(disturbed < 1.5);
    city.stop();
}
