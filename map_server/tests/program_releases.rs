//! The program `map_server` serving releases, and after a restart.

use std::path::Path;
use std::process::Stdio;
use std::time::Duration;

use client::{SessionOptions, open_session};
use map::store;
use protocol::{Format, MapChangeNotice, MapInfoReply};
use releases::{PublishOptions, ReleaseStore, publish};
use testing::{Place, PlaceOptions};

use crate::program::{Running, ask, program, run, signal, stored_map};

#[tokio::test(flavor = "multi_thread")]
async fn releases_are_followed_and_served_without_their_store() {
    let directory = tempfile::tempdir().unwrap();
    let [city, away, cache] = ["city", "away", "cache"].map(|name| directory.path().join(name));
    let url = format!("file://{}", city.display());
    let releases = ReleaseStore::open(&url).unwrap();
    let mut contents =
        Place::new(&PlaceOptions { keyframes: 5, landmarks: 100, ..PlaceOptions::default() }).map;
    contents.info.identity = Some(contents.digest());
    publish(&releases, contents.clone(), &PublishOptions::default(), |_| {}).await.unwrap();

    let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let (endpoint, map) = (format!("tcp/127.0.0.1:{port}"), format!("hall={url}"));
    let cache = cache.display().to_string();
    let arguments = ["--map", &map, "--listen", &endpoint, "--cache", &cache, "--watch-releases", "1"];
    let log = directory.path().join("log");
    let start = || {
        let stderr = Stdio::from(std::fs::File::options().create(true).append(true).open(&log).unwrap());
        Running(program().args(arguments).stderr(stderr).spawn().unwrap())
    };
    let says = async |what: &str| {
        while !std::fs::read_to_string(&log).unwrap().contains(what) {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    let server = start();
    let options = SessionOptions { connect: vec![endpoint.clone()], ..SessionOptions::default() };
    let client = open_session(&options).await.unwrap();
    let info = async || {
        let info = ask(&client, "map/hall/info").await.unwrap();
        protocol::decode::<MapInfoReply>(Format::Bincode, &info).unwrap()
    };
    let first = info().await;
    assert_eq!((first.version, first.keyframes, Some(first.identity)), (1, 5, contents.info.identity));

    // The next release is served without a signal, and robots are told.
    let news = client.declare_subscriber("map/hall/changes").await.unwrap();
    contents.keyframes[2].global_from_keyframe.pose.translation.x += 0.25;
    publish(&releases, contents.clone(), &PublishOptions::default(), |_| {}).await.unwrap();
    let notice = news.recv_async().await.unwrap().payload().to_bytes().into_owned();
    let notice: MapChangeNotice = protocol::decode(Format::Bincode, &notice).unwrap();
    assert_eq!((notice.from_version, notice.version, notice.moved), (1, 2, vec![contents.keyframes[2].id]));
    assert_eq!(info().await.version, 2);

    // The store is away: the server goes on, and a restarted one serves what it served last.
    std::fs::rename(&city, &away).unwrap();
    signal(&server, "-HUP");
    drop(server);
    let server = start();
    says("serving the one that was served last").await;
    assert_eq!(info().await.version, 2);

    // A damaged release is refused with the segment's name; once it is whole, it is served.
    std::fs::rename(&away, &city).unwrap();
    contents.keyframes[3].global_from_keyframe.pose.translation.y += 0.25;
    signal(&server, "-STOP");
    publish(&releases, contents.clone(), &PublishOptions::default(), |_| {}).await.unwrap();
    let newest = releases.newest().await.unwrap().unwrap();
    let new = city.join("segments").join(&newest.cells[0].segment.sha256);
    let whole = std::fs::read(&new).unwrap();
    std::fs::write(&new, &whole[..whole.len() - 3]).unwrap();
    signal(&server, "-CONT");
    says("is damaged").await;
    assert!(std::fs::read_to_string(&log).unwrap().contains(new.file_name().unwrap().to_str().unwrap()));
    assert_eq!(info().await.version, 2);
    std::fs::write(&new, &whole).unwrap();
    while info().await.version < 3 {
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    client.close().await.unwrap();
}

#[test]
fn a_folder_of_releases_is_served_like_its_url_and_a_database_stays_one() {
    let directory = tempfile::tempdir().unwrap();
    let folder = directory.path().join("city");
    let place = Place::new(&PlaceOptions { keyframes: 5, landmarks: 100, ..PlaceOptions::default() });
    let published = tokio::runtime::Runtime::new().unwrap().block_on(async {
        let releases = ReleaseStore::open(folder.to_str().unwrap()).unwrap();
        publish(&releases, place.map.clone(), &PublishOptions::default(), |_| {}).await
    });
    published.unwrap();
    let (map, cache) = (format!("city={}", folder.display()), directory.path().join("cache"));
    let serve = |more: &[&str], says: &str| {
        let log = directory.path().join("log");
        let stderr = Stdio::from(std::fs::File::create(&log).unwrap());
        let mut command = program();
        command.args(["--map", &map, "--listen", "tcp/127.0.0.1:0"]).args(more).arg("--cache").arg(&cache);
        let mut server = Running(command.stderr(stderr).spawn().unwrap());
        let read = || std::fs::read_to_string(&log).unwrap();
        while !(read().contains("ready") && read().contains(says)) {
            assert!(server.0.try_wait().unwrap().is_none(), "{}", read());
            std::thread::sleep(Duration::from_millis(20));
        }
        signal(&server, "-TERM");
        assert!(server.0.wait().unwrap().success());
    };
    serve(&[], "fetched a release");
    serve(&["--cells", "auto"], "serving a map by cells");

    // A map that is written beside them is what was asked for by its path; its releases still have a URL.
    stored_map(&folder.join("of_map"));
    for entry in std::fs::read_dir(folder.join("of_map")).unwrap() {
        let entry = entry.unwrap();
        std::fs::rename(entry.path(), folder.join(entry.file_name())).unwrap();
    }
    serve(&[], "loaded a map");
    assert!(!std::fs::read_to_string(directory.path().join("log")).unwrap().contains("fetched a release"));
    let (output, error) = run(&["--map", &map, "--cells", "auto"]);
    assert!(!output.status.success() && error.contains("NAME=FOLDER"), "{error}");
}

#[test]
fn a_restarted_server_says_where_a_map_is_older_than_before_or_another_one() {
    let directory = tempfile::tempdir().unwrap();
    let [path, backup, other] = ["hall.db", "backup.db", "other.db"].map(|name| directory.path().join(name));
    stored_map(&path);
    testing::copy_folder(&path, &backup);
    let mut contents = store::load_map(&path).unwrap().contents;
    contents.keyframes[1].global_from_keyframe.pose.translation.x += 0.1;
    store::save_map(&path, &contents, true).unwrap();
    let place =
        Place::new(&PlaceOptions { seed: 2, keyframes: 5, landmarks: 100, ..PlaceOptions::default() });
    store::save_map(&other, &place.map, false).unwrap();
    let state = directory.path().join("state");
    let log_of = |map: &Path| {
        let log = directory.path().join("log");
        let mut command = program();
        command.args(["--map", &format!("hall={}", map.display()), "--listen", "tcp/127.0.0.1:0"]);
        command.arg("--state").arg(&state).stderr(Stdio::from(std::fs::File::create(&log).unwrap()));
        let mut server = Running(command.spawn().unwrap());
        let read = || std::fs::read_to_string(&log).unwrap();
        while !read().contains("ready") {
            assert!(server.0.try_wait().unwrap().is_none(), "{}", read());
            std::thread::sleep(Duration::from_millis(20));
        }
        // SIGKILL: what was noted is there all the same.
        drop(server);
        read()
    };
    let [older, another] = ["is older than the version that this server served before", "is not the one"];
    let says = |map: &Path| {
        let log = log_of(map);
        [older, another].map(|what| log.contains(what))
    };
    assert_eq!(says(&path), [false, false]);
    assert_eq!(says(&path), [false, false]);
    assert_eq!(says(&backup), [true, false]);
    assert_eq!(says(&backup), [false, false], "it was said");
    assert_eq!(says(&other), [false, true]);
    // A state that cannot be read keeps nobody from being served.
    std::fs::remove_dir_all(&state).unwrap();
    std::fs::write(&state, "no folder").unwrap();
    assert!(log_of(&path).contains("nothing is kept for the next start"));
    std::fs::remove_file(&state).unwrap();
    std::fs::create_dir(&state).unwrap();
    for file in ["db", "conf"] {
        std::fs::write(state.join(file), vec![7; 3000]).unwrap();
        assert!(log_of(&path).contains("serving"));
    }
}
