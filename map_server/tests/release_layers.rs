//! What the live map says of the releases of a map: what changed since the one before, and what a candidate would change.

use std::net::SocketAddr;
use std::process::Stdio;
use std::time::{Duration, Instant};

use map::MapContents;
use releases::{Note, PublishOptions, ReleaseStore, Stage, promote, publish, reject};
use serde_json::Value;
use testing::{Place, PlaceOptions};

use crate::cells::page::get;
use crate::program::{Running, program};

async fn put(store: &ReleaseStore, map: &MapContents, stage: Stage) {
    let mut options = PublishOptions::default();
    options.stage = stage;
    publish(store, map.clone(), &options, |_| {}).await.unwrap();
}

/// What the page is told once it satisfies a condition.
async fn changes(address: SocketAddr, is_so: impl Fn(&Value) -> bool) -> Value {
    let begin = Instant::now();
    loop {
        let body = match tokio::net::TcpStream::connect(address).await {
            Ok(_) => get(address, "/api/maps/city/changes").await,
            Err(_) => Vec::new(),
        };
        let answer: Value = serde_json::from_slice(&body).unwrap_or_default();
        if is_so(&answer) {
            return answer;
        }
        assert!(begin.elapsed() < Duration::from_mins(1), "{answer}");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

/// Counts of a change: moved, added, removed.
fn counts(change: &Value) -> [u64; 3] {
    ["moved", "added", "removed"].map(|kind| change[kind]["count"].as_u64().unwrap())
}

async fn check(switches: &[&str]) {
    let directory = tempfile::tempdir().unwrap();
    let city = directory.path().join("city").display().to_string();
    let store = ReleaseStore::open(&city).unwrap();
    let options = PlaceOptions { keyframes: 6, landmarks: 100, ..PlaceOptions::default() };
    let mut map = Place::new(&options).map;
    map.info.identity = Some(map.digest());
    put(&store, &map, Stage::Live).await;

    let [http, listen] =
        [0; 2].map(|_| std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap());
    let mut command = program();
    command.args(["--map", &format!("city={city}"), "--watch-releases", "1", "--http", &http.to_string()]);
    command.args(["--listen", &format!("tcp/{listen}")]).args(switches);
    command.arg("--cache").arg(directory.path().join("cache")).stderr(Stdio::null());
    let _server = Running(command.spawn().unwrap());
    let first = changes(http, |answer| answer["version"] == 1).await;
    assert!(first["since"].is_null() && first["candidate"].is_null(), "{first}");

    map.keyframes[2].global_from_keyframe.pose.translation.x += 0.3;
    let moved = map.keyframes[2].id;
    put(&store, &map, Stage::Live).await;
    let second = changes(http, |answer| answer["version"] == 2 && answer["since"].is_object()).await;
    let since = &second["since"];
    assert_eq!((&since["release"], counts(since)), (&"release 1".into(), [1, 0, 0]), "{second}");
    assert_eq!(since["moved"]["drawn"][0]["id"], moved);
    assert!((since["largest_motion_m"].as_f64().unwrap() - 0.3).abs() < 1e-9, "{second}");

    // A candidate is shown until it is rejected; nothing of it is served.
    map.keyframes[3].global_from_keyframe.pose.translation.y -= 0.2;
    put(&store, &map, Stage::Candidate).await;
    let proposed = changes(http, |answer| answer["candidate"].is_object()).await;
    assert_eq!((&proposed["version"], &proposed["candidate"]["release"]), (&2.into(), &"candidate 1".into()));
    assert_eq!((counts(&proposed["candidate"]), counts(&proposed["since"])), ([1, 0, 0], [1, 0, 0]));
    reject(&store, 1, &Note::default()).await.unwrap();
    let rejected = changes(http, |answer| answer["candidate"].is_null()).await;
    assert_eq!((&rejected["version"], counts(&rejected["since"])), (&2.into(), [1, 0, 0]));

    // Or until it is promoted: then it is what changed.
    map.keyframes[4].global_from_keyframe.pose.translation.y -= 0.2;
    put(&store, &map, Stage::Candidate).await;
    changes(http, |answer| answer["candidate"]["release"] == "candidate 2").await;
    promote(&store, 2, &Note::default()).await.unwrap();
    let promoted = changes(http, |answer| answer["since"]["release"] == "release 2").await;
    assert!(promoted["candidate"].is_null(), "{promoted}");
    assert_eq!(counts(&promoted["since"]), [2, 0, 0]);
}

#[tokio::test(flavor = "multi_thread")]
async fn changes_and_candidates_of_a_map_are_shown() {
    check(&[]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn changes_and_candidates_of_a_map_that_is_served_by_cells_are_shown() {
    check(&["--cells", "auto"]).await;
}
