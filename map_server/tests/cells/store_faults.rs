//! What becomes of queries while the store is slow, away, full, or has something else than was published.

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use client::MapClient;
use map::MapContents;
use map_server::CellChoice;
use object_store::memory::InMemory;
use object_store::throttle::{ThrottleConfig, ThrottledStore};
use protocol::{KeyframeId, MatchOutcome, MatchRequest};
use releases::{Note, Outcome, Published, ReleaseStore, fetch_cell, publish, roll_back};
use tokio::sync::oneshot;
use tokio::task::JoinHandle;

use super::servers::{CellServer, hub, session, wait_for_cells};
use super::town::{Town, requests, small_cells, soon};

/// A robot that asks again and again, and must get an answer within a second each time.
struct Asking {
    stop: oneshot::Sender<()>,
    running: JoinHandle<usize>,
}

impl Asking {
    fn start(city: MapClient, requests: Vec<MatchRequest>) -> Self {
        let (stop, mut stopped) = oneshot::channel();
        let running = tokio::spawn(async move {
            let mut answered = 0;
            for request in requests.iter().cycle() {
                if stopped.try_recv().is_ok() {
                    break;
                }
                let answer =
                    city.match_image(request, Instant::now() + Duration::from_secs(1)).await.unwrap();
                assert_eq!(answer.status.outcome, MatchOutcome::Matched);
                answered += 1;
                tokio::time::sleep(Duration::from_millis(50)).await;
            }
            answered
        });
        Self { stop, running }
    }

    async fn stop(self) {
        self.stop.send(()).unwrap();
        let answered = self.running.await.unwrap();
        assert!(answered > 10, "{answered}");
    }
}

/// The queries that the map answers.
fn answerable(town: &Town) -> Vec<MatchRequest> {
    let map = recognition::LoadedMap::from_contents(town.place.map.clone()).unwrap();
    let options = recognition::RecognitionOptions::default();
    let is_matched = |request: &MatchRequest| {
        let replies = map.answer(request, &options).unwrap();
        let is_match = |reply: &protocol::MatchReply| matches!(reply, protocol::MatchReply::Done(status) if status.outcome == MatchOutcome::Matched);
        replies.iter().any(is_match)
    };
    requests(&town.place).into_iter().filter(is_matched).collect()
}

/// The map with one keyframe elsewhere.
fn changed(town: &Town, keyframe: usize) -> MapContents {
    let mut next = town.place.map.clone();
    next.keyframes[keyframe].global_from_keyframe.pose.translation.x += 0.1;
    next
}

async fn published(store: &ReleaseStore, map: MapContents) -> Published {
    match publish(store, map, &small_cells(), |_| {}).await.unwrap() {
        Outcome::Published(published) => *published,
        Outcome::Unchanged { number } => panic!("release {number} has it already"),
    }
}

/// Waits until the map is served in a version.
async fn wait_for_version(city: &MapClient, version: u64) {
    let begin = Instant::now();
    while city.info(soon()).await.unwrap().version != version {
        assert!(begin.elapsed() < Duration::from_secs(90), "version {version} is not served");
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
}

async fn stays_at(city: &MapClient, version: u64, time: Duration) {
    let begin = Instant::now();
    while begin.elapsed() < time {
        assert_eq!(city.info(soon()).await.unwrap().version, version);
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
}

async fn two_servers(endpoint: &str, town: &Town, store: &ReleaseStore) -> Vec<CellServer> {
    let mut servers = Vec::new();
    for name in ["north", "south"] {
        servers.push(CellServer::start(endpoint, name, store, town.folder.path(), CellChoice::Auto).await);
    }
    servers
}

#[tokio::test(flavor = "multi_thread")]
async fn while_the_store_takes_a_second_a_request_robots_are_answered_and_the_release_comes() {
    let town = Town::new().await;
    let slow = Arc::new(ThrottledStore::new(InMemory::new(), ThrottleConfig::default()));
    let store = ReleaseStore::over(Arc::clone(&slow) as Arc<_>, "slow");
    published(&store, town.place.map.clone()).await;
    let (_hub, endpoint) = hub().await;
    let servers = two_servers(&endpoint, &town, &store).await;
    let robot = session(&endpoint).await;
    wait_for_cells(&robot, 2 * town.release.cells.len()).await;
    let city = MapClient::new(robot.clone(), "city").unwrap();

    slow.config_mut(|config| {
        config.wait_get_per_call = Duration::from_secs(1);
        config.wait_list_per_call = Duration::from_secs(1);
    });
    let asking = Asking::start(city.clone(), answerable(&town));
    let begin = Instant::now();
    let next = published(&store, changed(&town, 30)).await;
    wait_for_version(&city, next.release.map.version).await;
    assert!(begin.elapsed() > Duration::from_secs(8), "the store was not slow");
    asking.stop().await;
    for server in servers {
        server.stop().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_store_that_is_away_changes_nothing_and_a_server_starts_without_it() {
    let town = Town::new().await;
    let (_hub, endpoint) = hub().await;
    let mut servers = two_servers(&endpoint, &town, &town.store).await;
    let robot = session(&endpoint).await;
    let cells = town.release.cells.len();
    wait_for_cells(&robot, 2 * cells).await;
    let city = MapClient::new(robot.clone(), "city").unwrap();
    let asking = Asking::start(city.clone(), answerable(&town));

    let away = town.folder.path().join("away");
    std::fs::rename(&town.city, &away).unwrap();
    servers.pop().unwrap().stop().await;
    wait_for_cells(&robot, cells).await;
    // It has what it served last.
    let south = CellServer::start(&endpoint, "south", &town.store, town.folder.path(), CellChoice::Auto);
    servers.push(south.await);
    wait_for_cells(&robot, 2 * cells).await;
    stays_at(&city, town.release.map.version, Duration::from_secs(1)).await;

    std::fs::rename(&away, &town.city).unwrap();
    let next = published(&town.store, changed(&town, 30)).await;
    wait_for_version(&city, next.release.map.version).await;
    asking.stop().await;
    for server in servers {
        server.stop().await;
    }
}

/// A file of the store without its end.
fn tear(file: &Path) -> Vec<u8> {
    let bytes = std::fs::read(file).unwrap();
    std::fs::write(file, &bytes[..bytes.len() / 2]).unwrap();
    bytes
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_torn_or_has_a_wrong_hash_is_not_served() {
    let town = Town::new().await;
    let (_hub, endpoint) = hub().await;
    let servers = two_servers(&endpoint, &town, &town.store).await;
    let robot = session(&endpoint).await;
    wait_for_cells(&robot, 2 * town.release.cells.len()).await;
    let city = MapClient::new(robot.clone(), "city").unwrap();
    let asking = Asking::start(city.clone(), answerable(&town));
    let first = town.release.map.version;

    // While nobody looks, a release comes of which one segment has another byte.
    let away = town.folder.path().join("away");
    std::fs::rename(&town.city, &away).unwrap();
    let hidden = ReleaseStore::open(away.to_str().unwrap()).unwrap();
    let second = published(&hidden, changed(&town, 30)).await.release;
    let is_new = |sha256: &&String| !town.release.cells.iter().any(|cell| cell.segment.sha256 == **sha256);
    let new = second.cells.iter().map(|cell| &cell.segment.sha256).find(is_new).unwrap();
    let segment = |folder: &Path| folder.join("segments").join(new);
    let mut bytes = std::fs::read(segment(&away)).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(segment(&away), &bytes).unwrap();
    std::fs::rename(&away, &town.city).unwrap();
    stays_at(&city, first, Duration::from_secs(2)).await;
    // With the right byte it is served.
    bytes[middle] ^= 1;
    std::fs::write(segment(&town.city), &bytes).unwrap();
    wait_for_version(&city, second.map.version).await;

    // A release whose own file is torn, and then whole.
    std::fs::rename(&town.city, &away).unwrap();
    let third = published(&hidden, changed(&town, 20)).await.release;
    let file = format!("releases/{:020}.json", third.number);
    let whole = tear(&away.join(&file));
    std::fs::rename(&away, &town.city).unwrap();
    stays_at(&city, second.map.version, Duration::from_secs(2)).await;
    std::fs::write(town.city.join(&file), whole).unwrap();
    wait_for_version(&city, third.map.version).await;

    // A torn segment that nobody can mend: going back ends it.
    std::fs::rename(&town.city, &away).unwrap();
    let fourth = published(&hidden, changed(&town, 40)).await.release;
    let is_new = |sha256: &&String| !third.cells.iter().any(|cell| cell.segment.sha256 == **sha256);
    let torn = fourth.cells.iter().map(|cell| &cell.segment.sha256).find(is_new).unwrap();
    tear(&away.join("segments").join(torn));
    std::fs::rename(&away, &town.city).unwrap();
    stays_at(&city, third.map.version, Duration::from_secs(2)).await;
    let Outcome::Published(back) = roll_back(&town.store, third.number, &Note::default()).await.unwrap()
    else {
        panic!("nothing changed")
    };
    wait_for_version(&city, back.release.map.version).await;
    asking.stop().await;
    for server in servers {
        server.stop().await;
    }
}

/// Asks for a keyframe of each cell; those that were not sent.
async fn missing(city: &MapClient, keyframes: &[KeyframeId]) -> Vec<KeyframeId> {
    let mut missing = Vec::new();
    for &keyframe in keyframes {
        match city.keyframe(keyframe, Instant::now() + Duration::from_secs(4)).await {
            Ok(reply) => assert_eq!(reply.keyframe.id, keyframe),
            Err(error) => {
                assert!(error.is_transient(), "{error}");
                missing.push(keyframe);
            }
        }
    }
    missing
}

#[tokio::test(flavor = "multi_thread")]
async fn while_loading_a_cell_panics_the_others_are_served_and_then_it_is_too() {
    let town = Town::new().await;
    let faulty = Arc::new(ThrottledStore::new(InMemory::new(), ThrottleConfig::default()));
    let store = ReleaseStore::over(Arc::clone(&faulty) as Arc<_>, "faulty");
    let release = published(&store, town.place.map.clone()).await.release;
    let (_hub, endpoint) = hub().await;
    let all = "0-100".parse().unwrap();
    let folder = town.folder.path().join("only");
    // No cell stays in memory.
    let server = CellServer::with_memory(&endpoint, "only", &store, town.folder.path(), all, Some(1)).await;
    let robot = session(&endpoint).await;
    wait_for_cells(&robot, release.cells.len()).await;
    let city = MapClient::new(robot.clone(), "city").unwrap();
    let mut keyframes = Vec::new();
    for cell in &release.cells {
        keyframes.push(fetch_cell(&store, &release, cell.cell, None).await.unwrap().own[0]);
    }
    assert!(missing(&city, &keyframes).await.is_empty());

    // What the server has of one cell is gone, and its store panics where it should give a segment.
    std::fs::remove_file(folder.join("cold/0/0")).unwrap();
    std::fs::remove_dir_all(folder.join("segments")).unwrap();
    faulty.config_mut(|config| config.wait_get_per_byte = Duration::MAX);
    let lost = missing(&city, &keyframes).await;
    assert_eq!(lost.len(), 1, "{lost:?}");
    assert_eq!(missing(&city, &keyframes).await, lost);
    assert!(server.server.statistics().cold_loads_failed >= 2, "it is tried again for each who asks");

    faulty.config_mut(|config| config.wait_get_per_byte = Duration::ZERO);
    assert!(missing(&city, &keyframes).await.is_empty());
    server.stop().await;
}
