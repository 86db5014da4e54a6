//! A map that several servers serve by cells answers as one that one server has, and survives what happens to them.
#![allow(clippy::unwrap_used, missing_docs)]

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use client::{MapClient, SessionOptions, open_session};
use geometry::PoseWithCovariance;
use map_server::{CellChoice, CellService, CellServiceOptions, MapServer, ServedMap, ServerOptions};
use nalgebra::Matrix6;
use protocol::{Format, LocalizeRequest, MapChangeNotice, MatchOutcome, MatchRequest, PosePrior};
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};
use recognition::LoadedMap;
use releases::{PublishOptions, ReleaseStore, publish};
use testing::{Place, PlaceOptions};
use zenoh::Session;

async fn session(connect: &str) -> Session {
    let options = SessionOptions { connect: vec![connect.to_owned()], ..SessionOptions::default() };
    open_session(&options).await.unwrap()
}

/// The server of others: a router without a map.
async fn hub() -> (Session, String) {
    loop {
        let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let endpoint = format!("tcp/127.0.0.1:{port}");
        let mut config = zenoh::Config::default();
        config.insert_json5("mode", "\"router\"").unwrap();
        config.insert_json5("listen/endpoints", &format!("[\"{endpoint}\"]")).unwrap();
        config.insert_json5("scouting/multicast/enabled", "false").unwrap();
        if let Ok(session) = zenoh::open(config).await {
            return (session, endpoint);
        }
    }
}

struct CellServer {
    session: Session,
    server: MapServer,
    service: CellService,
}

impl CellServer {
    async fn start(
        endpoint: &str,
        name: &str,
        store: &ReleaseStore,
        folder: &Path,
        choice: CellChoice,
    ) -> Self {
        let session = session(endpoint).await;
        let mut options = ServerOptions::default();
        options.name = Some(name.to_owned());
        let server = MapServer::start(session.clone(), Vec::new(), options).await.unwrap();
        let mut options = CellServiceOptions::new(folder.join(name));
        options.choice = choice;
        options.watch = Duration::from_millis(300);
        let service = CellService::start(&server, "city", store.clone(), options).await.unwrap();
        Self { session, server, service }
    }

    async fn stop(self) {
        self.service.stop().await;
        self.server.stop().await.unwrap();
        self.session.close().await.unwrap();
    }
}

/// Waits until so many tokens are alive.
async fn wait_for(client: &Session, keys: &str, count: usize) {
    let begin = Instant::now();
    loop {
        let tokens = client.liveliness().get(keys).await.unwrap();
        let mut found = 0;
        while tokens.recv_async().await.is_ok() {
            found += 1;
        }
        if found == count {
            return;
        }
        assert!(begin.elapsed() < Duration::from_mins(1), "{found} of {count} tokens at {keys}");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

/// Waits until so many cells are at servers, each counted for each of them.
async fn wait_for_cells(client: &Session, count: usize) {
    wait_for(client, "map/city/cell/*/server/*", count).await;
}

async fn wait_for_members(client: &Session, count: usize) {
    wait_for(client, "map/city/server/*", count).await;
}

fn town() -> Place {
    Place::new(&PlaceOptions { keyframes: 60, landmarks: 3000, ..PlaceOptions::default() })
}

/// Queries along the path: without a prior, with one, with keyframes that the robot holds.
fn requests(place: &Place) -> Vec<MatchRequest> {
    let mut rng = StdRng::seed_from_u64(7);
    let mut requests = Vec::new();
    for (at, pose) in place.path.iter().enumerate().step_by(3) {
        let mut request = place.request(pose, 8, &mut rng);
        if at % 2 == 0 {
            let covariance = Matrix6::identity() * 0.05_f64.powi(2);
            request.prior =
                Some(PosePrior { global_from_camera: PoseWithCovariance::new(*pose, covariance) });
        }
        if at % 4 == 0 {
            request.held = (0..6).map(|_| 10 + rng.random_range(0..60)).collect();
            request.held.sort_unstable();
            request.held.dedup();
        }
        requests.push(request);
    }
    requests
}

fn soon() -> Instant {
    Instant::now() + Duration::from_secs(20)
}

#[tokio::test(flavor = "multi_thread")]
async fn cells_at_several_servers_answer_as_one_map_through_the_loss_of_a_server_and_a_release() {
    let place = town();
    let folder = tempfile::tempdir().unwrap();
    let store = ReleaseStore::open(folder.path().join("city").to_str().unwrap()).unwrap();
    let mut options = PublishOptions::default();
    options.keyframes_a_cell = 10;
    publish(&store, place.map.clone(), &options, |_| {}).await.unwrap();
    let release = store.newest().await.unwrap().unwrap();
    let cells = release.cells.len();
    assert_eq!(cells, 8);

    let (_hub, endpoint) = hub().await;
    let mut servers = Vec::new();
    for name in ["north", "south", "west"] {
        servers.push(CellServer::start(&endpoint, name, &store, folder.path(), CellChoice::Auto).await);
    }
    let robot = session(&endpoint).await;
    wait_for_cells(&robot, 2 * cells).await;
    let whole = session(&endpoint).await;
    let map = ServedMap {
        name: "whole".to_owned(),
        map: Arc::new(LoadedMap::from_contents(place.map.clone()).unwrap()),
    };
    let one = MapServer::start(whole.clone(), vec![map], ServerOptions::default()).await.unwrap();
    let [city, reference] = ["city", "whole"].map(|name| MapClient::new(robot.clone(), name).unwrap());

    let info = city.info(soon()).await.unwrap();
    let expected = reference.info(soon()).await.unwrap();
    assert_eq!((info.keyframes, info.landmarks), (expected.keyframes, expected.landmarks));
    assert_eq!(
        (info.observations, info.cross_covariances),
        (expected.observations, expected.cross_covariances)
    );
    assert_eq!((info.extent, info.identity), (expected.extent, release.map.identity));

    // The same images are recognized, at the same places, with the same correlations.
    let (mut matched, mut landmarks) = (0, [0, 0]);
    for request in requests(&place) {
        let answer = city.match_image(&request, soon()).await.unwrap();
        let expected = reference.match_image(&request, soon()).await.unwrap();
        assert_eq!(answer.status.outcome, expected.status.outcome);
        if answer.status.outcome != MatchOutcome::Matched {
            continue;
        }
        matched += 1;
        let count = |answer: &client::MatchAnswer| -> usize {
            answer.keyframes.iter().map(|keyframe| keyframe.matches.len()).sum()
        };
        landmarks = [landmarks[0] + count(&answer), landmarks[1] + count(&expected)];
        for keyframe in &answer.keyframes {
            let same = expected.keyframes.iter().find(|other| other.keyframe.id == keyframe.keyframe.id);
            let Some(same) = same else { continue };
            assert_eq!(keyframe.keyframe, same.keyframe);
            for cross in &same.cross_covariances {
                let both = answer.keyframes.iter().any(|other| other.keyframe.id == cross.other);
                if both && keyframe.rank == same.rank || request.held.contains(&cross.other) {
                    let block = keyframe.cross_covariances.iter().find(|other| other.other == cross.other);
                    let block = block.or_else(|| {
                        let other = answer.keyframes.iter().find(|other| other.keyframe.id == cross.other)?;
                        other.cross_covariances.iter().find(|back| back.other == keyframe.keyframe.id)
                    });
                    assert!(block.is_some(), "a correlation is missing");
                }
            }
        }
        let localize = LocalizeRequest {
            camera: request.camera.clone(),
            features: request.features.clone(),
            prior: request.prior.clone(),
            gravity_in_camera: None,
        };
        let [fix, expected] = [&city, &reference].map(|map| map.localize(&localize, soon()));
        let (fix, expected) = (fix.await.unwrap(), expected.await.unwrap());
        assert_eq!(fix.outcome, expected.outcome);
        if let Some((fix, expected)) = fix.fix.zip(expected.fix) {
            let apart = fix.global_from_camera.pose.local(&expected.global_from_camera.pose);
            assert!(apart.norm() < 0.05, "{apart}");
        }
    }
    assert!(matched >= 18, "{matched} of 20");
    assert!(landmarks[0] * 10 > landmarks[1] * 9, "{landmarks:?}");
    let keyframe = city.keyframe(place.map.keyframes[33].id, soon()).await.unwrap();
    let same = reference.keyframe(place.map.keyframes[33].id, soon()).await.unwrap();
    assert_eq!((keyframe.keyframe, keyframe.landmarks), (same.keyframe, same.landmarks));
    let replies =
        robot.get("map/city/keyframes/*").consolidation(zenoh::query::ConsolidationMode::None).await.unwrap();
    let mut all = 0;
    while let Ok(reply) = replies.recv_async().await {
        all += usize::from(reply.result().is_ok());
    }
    assert_eq!(all, 60);

    // A server goes: its cells are at the two others, and no query fails meanwhile.
    servers.pop().unwrap().stop().await;
    for request in requests(&place).iter().take(8) {
        let answer = city.match_image(request, soon()).await.unwrap();
        assert_eq!(answer.status.outcome, MatchOutcome::Matched);
    }
    wait_for_cells(&robot, 2 * cells).await;

    // A release: all servers change over, and robots are told once what changed.
    let notices = robot.declare_subscriber("map/city/changes").await.unwrap();
    let mut next = place.map.clone();
    next.keyframes[30].global_from_keyframe.pose.translation.x += 0.2;
    publish(&store, next, &options, |_| {}).await.unwrap();
    let notice = notices.recv_async().await.unwrap().payload().to_bytes().into_owned();
    let notice: MapChangeNotice = protocol::decode(Format::Bincode, &notice).unwrap();
    assert_eq!((notice.from_version, notice.version), (release.map.version, release.map.version + 1));
    assert_eq!(notice.moved, [place.map.keyframes[30].id]);
    for request in requests(&place).iter().take(8) {
        let answer = city.match_image(request, soon()).await.unwrap();
        assert_eq!(answer.status.outcome, MatchOutcome::Matched);
        assert_eq!(answer.status.map_version, notice.version);
    }
    for server in servers {
        server.stop().await;
    }
    one.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_cell_without_a_server_is_no_missing_match() {
    let place = town();
    let folder = tempfile::tempdir().unwrap();
    let store = ReleaseStore::open(folder.path().join("city").to_str().unwrap()).unwrap();
    let mut options = PublishOptions::default();
    options.keyframes_a_cell = 10;
    publish(&store, place.map.clone(), &options, |_| {}).await.unwrap();
    let release = store.newest().await.unwrap().unwrap();
    let half: Vec<u32> = release.cells.iter().map(|cell| cell.cell).filter(|cell| cell % 2 == 0).collect();
    let text = half.iter().map(u32::to_string).collect::<Vec<_>>().join(",");

    let (_hub, endpoint) = hub().await;
    let only = CellServer::start(&endpoint, "only", &store, folder.path(), text.parse().unwrap()).await;
    let robot = session(&endpoint).await;
    wait_for_cells(&robot, half.len()).await;
    let city = MapClient::new(robot.clone(), "city").unwrap();
    let (mut matched, mut refused) = (0, 0);
    let mut rng = StdRng::seed_from_u64(3);
    for pose in place.path.iter().step_by(7) {
        let request = place.request(pose, 8, &mut rng);
        match city.match_image(&request, Instant::now() + Duration::from_millis(300)).await {
            Ok(answer) => {
                assert_eq!(answer.status.outcome, MatchOutcome::Matched);
                matched += 1;
            }
            Err(error) => {
                assert!(error.is_transient(), "{error}");
                refused += 1;
            }
        }
    }
    assert!(matched > 0 && refused > 0, "{matched} matched, {refused} refused");
    only.stop().await;
}

/// A server of its own process, killed when it is dropped.
struct Process(std::process::Child);

impl Process {
    fn start(endpoint: &str, name: &str, store: &Path, cache: &Path) -> Process {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_map_server"));
        command.args([
            "--map",
            &format!("city=file://{}", store.display()),
            "--cells",
            "auto",
            "--name",
            name,
        ]);
        command.args(["--connect", endpoint, "--watch-releases", "2", "--log", "warn"]);
        command.arg("--cache").arg(cache.join(name));
        Process(command.spawn().unwrap())
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // SIGKILL.
        self.0.kill().unwrap();
        self.0.wait().unwrap();
    }
}

/// Four servers of which some are killed at once, again and again, while a robot asks.
async fn kills(rounds: usize, at_once: usize, deadline: Duration) {
    let place = town();
    let folder = tempfile::tempdir().unwrap();
    let city = folder.path().join("city");
    let store = ReleaseStore::open(city.to_str().unwrap()).unwrap();
    let mut options = PublishOptions::default();
    options.keyframes_a_cell = 10;
    publish(&store, place.map.clone(), &options, |_| {}).await.unwrap();
    let cells = store.newest().await.unwrap().unwrap().cells.len();
    let (_hub, endpoint) = hub().await;
    let names = ["north", "south", "west", "east"];
    let start = |name: &str| Process::start(&endpoint, name, &city, folder.path());
    let mut servers: Vec<Process> = names.iter().map(|name| start(name)).collect();
    let robot = session(&endpoint).await;
    wait_for_members(&robot, 4).await;
    wait_for_cells(&robot, 2 * cells).await;

    let (stop, mut stopped) = tokio::sync::oneshot::channel::<()>();
    let asking = {
        let (client, requests) = (MapClient::new(robot.clone(), "city").unwrap(), requests(&place));
        tokio::spawn(async move {
            let (mut answered, mut lost, mut slowest) = (0, Vec::new(), Duration::ZERO);
            for request in requests.iter().cycle() {
                if stopped.try_recv().is_ok() {
                    break;
                }
                let begin = Instant::now();
                match client.match_image(request, begin + deadline).await {
                    Ok(_) => answered += 1,
                    Err(error) => lost.push(error.to_string()),
                }
                slowest = slowest.max(begin.elapsed());
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
            (answered, lost, slowest)
        })
    };
    let mut settled = Duration::ZERO;
    for round in 0..rounds {
        let killed: Vec<usize> = (0..at_once).map(|next| (round + next) % 4).collect();
        let begin = Instant::now();
        for at in &killed {
            // The new process is started once the other one is gone.
            servers[*at].0.kill().unwrap();
        }
        wait_for_members(&robot, 4 - at_once).await;
        wait_for_cells(&robot, 2 * cells).await;
        settled = settled.max(begin.elapsed());
        for at in killed {
            servers[at] = start(names[at]);
        }
        wait_for_members(&robot, 4).await;
        wait_for_cells(&robot, 2 * cells).await;
    }
    stop.send(()).unwrap();
    let (answered, lost, slowest) = asking.await.unwrap();
    println!("{answered} answers, the slowest after {slowest:?}; cells assigned anew within {settled:?}");
    assert!(lost.is_empty(), "{} of {answered} queries were lost: {:?}", lost.len(), lost[0]);
    assert!(answered > 10 * rounds);
}

#[tokio::test(flavor = "multi_thread")]
async fn no_answer_is_lost_when_a_server_is_killed() {
    kills(1, 1, Duration::from_secs(2)).await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "takes ten minutes"]
async fn no_answer_is_lost_when_servers_are_killed_fifty_times() {
    kills(50, 1, Duration::from_secs(2)).await;
    kills(10, 2, Duration::from_secs(5)).await;
}

#[test]
fn choices_of_cells_are_read() {
    assert_eq!("auto".parse(), Ok(CellChoice::Auto));
    assert_eq!("3".parse(), Ok(CellChoice::These([3].into())));
    assert_eq!("0-2, 7".parse(), Ok(CellChoice::These([0, 1, 2, 7].into())));
    for wrong in ["", "all", "3-", "5-3", "-1", "0-4000000000"] {
        assert!(wrong.parse::<CellChoice>().is_err(), "{wrong}");
    }
}
