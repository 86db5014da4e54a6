//! A server that follows candidates serves them beside the live map, and leads its robots back where one is rejected.

use std::path::Path;
use std::process::Stdio;
use std::time::Duration;

use client::{SessionOptions, close_session, open_session};
use map::MapContents;
use protocol::{Format, MapChangeNotice, MapInfoReply};
use releases::{
    Note, Outcome, PublishOptions, Release, ReleaseCache, ReleaseStore, Stage, promote, publish, reject,
};
use testing::{Place, PlaceOptions};

use crate::program::{Running, ask, program, run, signal};

async fn put(store: &ReleaseStore, map: &MapContents, stage: Stage) -> u64 {
    let mut options = PublishOptions::default();
    options.stage = stage;
    match publish(store, map.clone(), &options, |_| {}).await.unwrap() {
        Outcome::Published(published) => published.release.map.version,
        Outcome::Unchanged { number } => panic!("release {number} has it"),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn candidates_are_served_under_their_own_name_only() {
    let directory = tempfile::tempdir().unwrap();
    let city = directory.path().join("city").display().to_string();
    let store = ReleaseStore::open(&city).unwrap();
    let options = PlaceOptions { keyframes: 5, landmarks: 100, ..PlaceOptions::default() };
    let mut map = Place::new(&options).map;
    map.info.identity = Some(map.digest());
    assert_eq!(put(&store, &map, Stage::Live).await, 1);
    let mut moved = |by: f64| {
        map.keyframes[2].global_from_keyframe.pose.translation.x += by;
        map.clone()
    };

    let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let maps = [format!("city={city}"), format!("next={city}@candidate")];
    let mut command = program();
    command.args(["--map", &maps[0], "--map", &maps[1], "--listen", &endpoint, "--watch-releases", "1"]);
    command.arg("--cache").arg(directory.path().join("cache")).stderr(Stdio::null());
    let _server = Running(command.spawn().unwrap());
    let options = SessionOptions { connect: vec![endpoint], ..SessionOptions::default() };
    let session = open_session(&options).await.unwrap();
    let version = async |name: &str| {
        let info = ask(&session, &format!("map/{name}/info")).await.unwrap();
        protocol::decode::<MapInfoReply>(Format::Bincode, &info).unwrap().version
    };
    let waited_for = async |name: &str, wanted: u64| {
        while version(name).await != wanted {
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    };
    // Where nothing is proposed it serves what is live.
    assert_eq!((version("city").await, version("next").await), (1, 1));
    let news = session.declare_subscriber("map/next/changes").await.unwrap();
    let notice = async || {
        let notice = news.recv_async().await.unwrap().payload().to_bytes().into_owned();
        protocol::decode::<MapChangeNotice>(Format::Bincode, &notice).unwrap()
    };
    assert_eq!(put(&store, &moved(0.3), Stage::Candidate).await, 2);
    waited_for("next", 2).await;
    let there = notice().await;
    reject(&store, 1, &Note::default()).await.unwrap();
    waited_for("next", 3).await;
    let back = notice().await;
    assert_eq!((there.moved.len(), &there.moved), (1, &back.moved));
    assert_eq!((back.from_version, back.version), (2, 3));
    assert_eq!(version("city").await, 1);

    // One that is promoted changes nothing for those who had it.
    let promoted = put(&store, &moved(-0.2), Stage::Candidate).await;
    waited_for("next", promoted).await;
    promote(&store, 2, &Note::default()).await.unwrap();
    waited_for("city", promoted).await;
    assert_eq!(version("next").await, promoted);
    close_session(&session).await;

    let (output, error) = run(&["--map", &maps[1], "--cells", "auto", "--listen", "tcp/127.0.0.1:0"]);
    assert!(!output.status.success() && error.contains("without --cells"), "{error}");
}

/// A store with a live release, its map, and a server that follows its candidates as `next`.
struct Following {
    directory: tempfile::TempDir,
    store: ReleaseStore,
    map: MapContents,
    server: Running,
    session: zenoh::Session,
}

impl Following {
    async fn start() -> Following {
        let directory = tempfile::tempdir().unwrap();
        let store = ReleaseStore::open(directory.path().join("city").to_str().unwrap()).unwrap();
        let options = PlaceOptions { keyframes: 5, landmarks: 100, ..PlaceOptions::default() };
        let mut map = Place::new(&options).map;
        map.info.identity = Some(map.digest());
        put(&store, &map, Stage::Live).await;
        let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let endpoint = format!("tcp/127.0.0.1:{port}");
        let server = Self::server(directory.path(), &endpoint);
        let options = SessionOptions { connect: vec![endpoint], ..SessionOptions::default() };
        let session = open_session(&options).await.unwrap();
        Following { directory, store, map, server, session }
    }

    fn server(directory: &Path, endpoint: &str) -> Running {
        let log = std::fs::File::options().create(true).append(true).open(directory.join("log")).unwrap();
        let map = format!("next={}@candidate", directory.join("city").display());
        let mut command = program();
        command.args(["--map", &map, "--listen", endpoint, "--watch-releases", "1", "--cache"]);
        Running(command.arg(directory.join("cache")).stderr(log).spawn().unwrap())
    }

    /// Proposes the map with a keyframe that has moved along x (m).
    async fn propose(&mut self, by: f64) -> u64 {
        self.map.keyframes[2].global_from_keyframe.pose.translation.x += by;
        put(&self.store, &self.map, Stage::Candidate).await
    }

    async fn serves(&self, version: u64) {
        loop {
            let info = ask(&self.session, "map/next/info").await.unwrap();
            if protocol::decode::<MapInfoReply>(Format::Bincode, &info).unwrap().version == version {
                return;
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    }

    /// How often the log of the server says something.
    fn says(&self, what: &str) -> usize {
        std::fs::read_to_string(self.directory.path().join("log")).unwrap().matches(what).count()
    }

    /// The release that the cache names, and how many segments it has.
    fn cached(&self) -> (Release, usize) {
        let cache = ReleaseCache::open(&self.directory.path().join("cache/next")).unwrap();
        let segments = std::fs::read_dir(self.directory.path().join("cache/next/segments")).unwrap();
        (cache.release().unwrap(), segments.count())
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_older_candidate_that_is_promoted_replaces_the_newer_one() {
    let mut following = Following::start().await;
    following.serves(1).await;
    let older = following.propose(0.3).await;
    let newer = following.propose(0.4).await;
    following.serves(newer).await;
    let news = following.session.declare_subscriber("map/next/changes").await.unwrap();
    let promoted = promote(&following.store, 1, &Note::default()).await.unwrap();
    assert!(promoted.map.version == older && older < newer);
    following.serves(newer + 1).await;
    let notice = news.recv_async().await.unwrap().payload().to_bytes().into_owned();
    let notice: MapChangeNotice = protocol::decode(Format::Bincode, &notice).unwrap();
    assert_eq!((notice.from_version, notice.version, notice.moved.len()), (newer, newer + 1, 1));
    let (release, _) = following.cached();
    assert_eq!((release.digest, release.map.version), (promoted.digest, newer + 1));
    // Nothing is loaded again and again.
    let fetched = following.says("fetched a release");
    tokio::time::sleep(Duration::from_millis(2500)).await;
    assert_eq!((following.says("fetched a release"), following.says("reload refused")), (fetched, 0));
    close_session(&following.session).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_release_that_is_refused_is_loaded_once_and_does_not_take_the_place_of_the_served_one() {
    let mut following = Following::start().await;
    let version = following.propose(0.3).await;
    following.serves(version).await;
    let served = following.cached();
    // As if a backup of the store from before had been put in its place.
    let proposed = following.directory.path().join("city/candidates");
    std::fs::rename(&proposed, following.directory.path().join("aside")).unwrap();
    while following.says("reload refused") == 0 {
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    tokio::time::sleep(Duration::from_millis(2500)).await;
    assert_eq!((following.says("reload refused"), following.says("fetched a release")), (1, 3));
    let (release, segments) = following.cached();
    assert_eq!(release, served.0);
    assert!(segments >= served.1, "{segments} of {}", served.1);
    // Whoever sends SIGHUP is told again.
    signal(&following.server, "-HUP");
    while following.says("reload refused") == 1 {
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    close_session(&following.session).await;
}
