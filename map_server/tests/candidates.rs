//! A server that follows candidates serves them beside the live map, and leads its robots back where one is rejected.

use std::process::Stdio;
use std::time::Duration;

use client::{SessionOptions, close_session, open_session};
use map::MapContents;
use protocol::{Format, MapChangeNotice, MapInfoReply};
use releases::{Note, Outcome, PublishOptions, ReleaseStore, Stage, promote, publish, reject};
use testing::{Place, PlaceOptions};

use crate::program::{Running, ask, program, run};

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
