//! The program `map_server`, started as people start it.

use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use client::{SessionOptions, open_session};
use map::store;
use protocol::{ErrorCode, ErrorReply, Format, MapChangeNotice, MapInfoReply};
use rand::SeedableRng as _;
use rand::rngs::StdRng;
use testing::{Place, PlaceOptions};
use zenoh::Session;

/// The program, with a state of its own.
pub fn program() -> Command {
    static STARTED: AtomicUsize = AtomicUsize::new(0);
    let number = STARTED.fetch_add(1, Ordering::Relaxed);
    let state = format!("{}/state-{}-{number}", env!("CARGO_TARGET_TMPDIR"), std::process::id());
    let mut command = Command::new(env!("CARGO_BIN_EXE_map_server"));
    command.env("XDG_STATE_HOME", state);
    command
}

pub fn run(arguments: &[&str]) -> (Output, String) {
    let output = program().args(arguments).output().unwrap();
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    (output, error)
}

pub fn stored_map(path: &Path) {
    let place = Place::new(&PlaceOptions { keyframes: 5, landmarks: 100, ..PlaceOptions::default() });
    store::save_map(path, &place.map, false).unwrap();
}

/// Ends the program whatever happens in the test.
pub struct Running(pub Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The replies to a query, asked again while nobody is there.
pub async fn ask(session: &Session, selector: &str) -> Result<Vec<u8>, Vec<u8>> {
    loop {
        let replies = session.get(selector).await.unwrap();
        if let Ok(reply) = replies.recv_async().await {
            return match reply.into_result() {
                Ok(sample) => Ok(sample.payload().to_bytes().into_owned()),
                Err(error) => Err(error.payload().to_bytes().into_owned()),
            };
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

#[test]
fn wrong_arguments_say_what_to_do() {
    let (output, error) = run(&[]);
    assert!(!output.status.success() && error.contains("--map"), "{error}");
    let (output, error) = run(&["--map", "hall"]);
    assert!(!output.status.success() && error.contains("NAME=DB"), "{error}");
    let (output, error) = run(&["--map", "a/b=x"]);
    assert!(!output.status.success() && error.contains("a/b"), "{error}");
    let (output, error) = run(&["--map", "hall=file:///srv/hall", "--cells", "auto", "--memory", "8"]);
    assert!(!output.status.success() && error.contains("like 8G or 512M"), "{error}");
    let (output, error) = run(&["--map", "hall=file:///srv/hall", "--memory", "8G"]);
    assert!(!output.status.success() && error.contains("--cells"), "{error}");
    let (output, error) = run(&["--map", "hall=hall.db", "--config", "zenoh.json5"]);
    assert_eq!(output.status.code(), Some(2), "{error}");
    assert!(
        error.contains("--config: the switch is --zenoh-config") && error.lines().count() == 1,
        "{error}"
    );
    let (output, error) = run(&["--map", "hall=/does/not/exist"]);
    assert!(!output.status.success() && error.contains("/does/not/exist"), "{error}");
    assert!(error.contains("driftless build-map"), "{error}");
    let empty = tempfile::tempdir().unwrap();
    let (output, error) = run(&["--map", &format!("hall={}", empty.path().display())]);
    assert!(!output.status.success() && error.contains("the folder is empty"), "{error}");
    assert!(error.contains("driftless build-map"), "{error}");
    assert_eq!(std::fs::read_dir(empty.path()).unwrap().count(), 0);
}

#[test]
fn what_a_configuration_asks_for_in_vain_is_a_refusal_to_start() {
    let directory = tempfile::tempdir().unwrap();
    let (path, config) = (directory.path().join("hall.db"), directory.path().join("zenoh.json5"));
    stored_map(&path);
    let (map, file) = (format!("hall={}", path.display()), config.display().to_string());
    for (text, words) in [
        ("{ listen: { endpoints: ['quic/127.0.0.1:0'] } }", "only tcp and tls"),
        ("{ transport: { auth: { pubkey: { known_keys_file: 'keys' } } } }", "not by public keys"),
        ("{ listen: { endpoint: ['tcp/127.0.0.1:0'] } }", "endpoint"),
    ] {
        std::fs::write(&config, text).unwrap();
        let (output, error) = run(&["--map", &map, "--zenoh-config", &file]);
        assert!(!output.status.success() && error.contains(words), "{text}: {error}");
    }
    let folder = directory.path().display().to_string();
    let (output, error) = run(&["--map", &map, "--secure", &folder]);
    assert!(!output.status.success() && error.contains("driftless fleet init"), "{error}");
}

#[test]
fn passwords_are_not_logged() {
    let directory = tempfile::tempdir().unwrap();
    let (path, config) = (directory.path().join("hall.db"), directory.path().join("zenoh.json5"));
    let log = directory.path().join("log");
    stored_map(&path);
    let text = "{ listen: { endpoints: ['tcp/127.0.0.1:0'] },
        transport: { auth: { usrpwd: { user: 's1', password: 'rosebud' } } } }";
    std::fs::write(&config, text).unwrap();
    let map = format!("hall={}", path.display());
    let stderr = Stdio::from(std::fs::File::create(&log).unwrap());
    let arguments = ["--map", &map, "--zenoh-config", &config.display().to_string(), "--log", "trace"];
    let mut server = Running(program().args(arguments).stderr(stderr).spawn().unwrap());
    let read = || std::fs::read_to_string(&log).unwrap();
    while !read().contains("ready") {
        assert!(server.0.try_wait().unwrap().is_none(), "{}", read());
        std::thread::sleep(Duration::from_millis(20));
    }
    signal(&server, "-TERM");
    assert!(server.0.wait().unwrap().success());
    assert!(read().contains("TRACE") && !read().contains("rosebud"));
}

#[test]
fn help_teaches_by_example() {
    let output = program().arg("--help").output().unwrap();
    let help = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success());
    assert!(help.contains("map_server --map hall=maps/hall.db") && help.contains("--namespace"), "{help}");
}

#[tokio::test(flavor = "multi_thread")]
async fn it_serves_below_its_namespace_and_stops_on_sigterm() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("hall.db");
    stored_map(&path);
    let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let map = format!("hall={}", path.display());
    let arguments = ["--map", &map, "--listen", &endpoint, "--namespace", "north", "--name", "first"];
    let mut server = Running(program().args(arguments).stderr(Stdio::null()).spawn().unwrap());

    let options = SessionOptions {
        connect: vec![endpoint.clone()],
        namespace: Some("north".to_owned()),
        ..SessionOptions::default()
    };
    let client = open_session(&options).await.unwrap();
    let info: MapInfoReply =
        protocol::decode(Format::Bincode, &ask(&client, "map/hall/info").await.unwrap()).unwrap();
    assert_eq!((info.name.as_str(), info.keyframes, info.version), ("hall", 5, 1));
    let refusal = ask(&client, "map/cellar/info").await.unwrap_err();
    let refusal: ErrorReply = protocol::decode(Format::Bincode, &refusal).unwrap();
    assert_eq!(refusal.code, ErrorCode::UnknownMap);
    assert!(refusal.message.contains("hall"), "{refusal}");
    // The database is not held while it is served.
    assert!(store::load_map(&path).is_ok());

    let (second, error) = run(&["--map", &map, "--listen", &endpoint]);
    assert!(!second.status.success() && error.contains(&endpoint), "{error}");

    signal(&server, "-TERM");
    assert!(server.0.wait().unwrap().success());
    client.close().await.unwrap();
}

/// 200 queries wait, each of more than 4,000 features: they are abandoned, and their clients ask elsewhere.
#[tokio::test(flavor = "multi_thread")]
async fn sigterm_ends_it_within_three_seconds_also_under_load() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("hall.db");
    let place = Place::new(&PlaceOptions { keyframes: 40, landmarks: 4000, ..PlaceOptions::default() });
    store::save_map(&path, &place.map, false).unwrap();
    let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let map = format!("hall={}", path.display());
    let arguments = ["--map", &map, "--listen", &endpoint, "--workers", "1"];
    let mut server = Running(program().args(arguments).stderr(Stdio::null()).spawn().unwrap());
    let options = SessionOptions { connect: vec![endpoint], ..SessionOptions::default() };
    let client = open_session(&options).await.unwrap();
    ask(&client, "map/hall/info").await.unwrap();
    let mut rng = StdRng::seed_from_u64(1);
    let mut request = place.request(&place.path[0], 4, &mut rng);
    request.features = place.features(&place.path[0], 4000, &mut rng);
    let payload = protocol::encode(Format::Bincode, &request).unwrap();
    for _ in 0..200 {
        client.get("map/hall/match").payload(payload.clone()).callback(|_| ()).await.unwrap();
    }
    tokio::time::sleep(Duration::from_millis(200)).await;
    let asked = Instant::now();
    signal(&server, "-TERM");
    assert!(server.0.wait().unwrap().success());
    assert!(asked.elapsed() < Duration::from_secs(3), "{:?}", asked.elapsed());
    client.close().await.unwrap();
}

/// The response to a GET.
fn get(address: &str, path: &str) -> String {
    use std::io::{Read as _, Write as _};
    let mut stream = std::net::TcpStream::connect(address).unwrap();
    write!(stream, "GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n").unwrap();
    let mut text = String::new();
    stream.read_to_string(&mut text).unwrap();
    text
}

#[test]
fn the_page_shows_the_version_that_is_served_with_metrics_beside_it() {
    let directory = tempfile::tempdir().unwrap();
    let (path, log) = (directory.path().join("hall.db"), directory.path().join("log"));
    stored_map(&path);
    let map = format!("hall={}", path.display());
    let stderr = Stdio::from(std::fs::File::create(&log).unwrap());
    let arguments = ["--map", &map, "--listen", "tcp/127.0.0.1:0", "--http", "127.0.0.1:0"];
    let mut server = Running(program().args(arguments).stderr(stderr).spawn().unwrap());
    let read = || std::fs::read_to_string(&log).unwrap();
    while !read().contains("ready") {
        assert!(server.0.try_wait().unwrap().is_none(), "{}", read());
        std::thread::sleep(Duration::from_millis(20));
    }
    let text = read();
    let (_, rest) = text.split_once("shown on http://").unwrap();
    let address = rest.split_whitespace().next().unwrap();
    assert!(get(address, "/").contains("<title>Driftless</title>"));
    assert!(get(address, "/api/maps").contains(r#""name":"hall""#));
    assert!(get(address, "/api/maps").contains(r#""version":1"#));
    assert!(get(address, "/metrics").contains("driftless_map_server"));
    assert!(get(address, "/health").starts_with("HTTP/1.1 200"));

    let contents = store::load_map(&path).unwrap().contents;
    store::save_map(&path, &contents, true).unwrap();
    signal(&server, "-HUP");
    while !get(address, "/api/maps").contains(r#""version":2"#) {
        assert!(server.0.try_wait().unwrap().is_none(), "{}", read());
        std::thread::sleep(Duration::from_millis(20));
    }
    signal(&server, "-TERM");
    assert!(server.0.wait().unwrap().success());
}

/// Sends a signal to the program.
pub fn signal(server: &Running, name: &str) {
    let process = server.0.id().to_string();
    assert!(Command::new("kill").args([name, &process]).status().unwrap().success());
}

#[tokio::test(flavor = "multi_thread")]
async fn sighup_serves_the_new_version_and_says_what_changed() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("hall.db");
    let log = directory.path().join("log");
    stored_map(&path);
    let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let map = format!("hall={}", path.display());
    let arguments = ["--map", &map, "--listen", &endpoint];
    let stderr = Stdio::from(std::fs::File::create(&log).unwrap());
    let mut server = Running(program().args(arguments).stderr(stderr).spawn().unwrap());
    let client =
        open_session(&SessionOptions { connect: vec![endpoint], ..SessionOptions::default() }).await.unwrap();
    let version = async || {
        let info = ask(&client, "map/hall/info").await.unwrap();
        protocol::decode::<MapInfoReply>(Format::Bincode, &info).unwrap().version
    };
    let says = async |what: &str, times: usize| {
        while std::fs::read_to_string(&log).unwrap().matches(what).count() < times {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    assert_eq!(version().await, 1);
    let news = client.declare_subscriber("map/hall/changes").await.unwrap();

    // Nothing new; then an unfinished map.
    signal(&server, "-HUP");
    says("has the version that is served", 1).await;
    let (manifest, aside) = (path.join("manifest.json"), directory.path().join("manifest.json"));
    std::fs::rename(&manifest, &aside).unwrap();
    signal(&server, "-HUP");
    says("the previous version continues to be served", 1).await;
    assert!(std::fs::read_to_string(&log).unwrap().contains("is unfinished"));
    assert_eq!(version().await, 1);
    std::fs::rename(&aside, &manifest).unwrap();

    // Another map under the same path.
    let former = directory.path().join("former.db");
    std::fs::rename(&path, &former).unwrap();
    let other = PlaceOptions { seed: 2, keyframes: 5, landmarks: 100, ..PlaceOptions::default() };
    store::save_map(&path, &Place::new(&other).map, false).unwrap();
    signal(&server, "-HUP");
    says("is another map", 1).await;
    says("the previous version continues to be served", 2).await;
    std::fs::remove_dir_all(&path).unwrap();
    std::fs::rename(&former, &path).unwrap();

    // A damaged one.
    let database = path.join("version-1.segments");
    let whole = std::fs::read(&database).unwrap();
    std::fs::write(&database, &whole[..whole.len() * 99 / 100]).unwrap();
    signal(&server, "-HUP");
    says("version-1.segments has", 1).await;
    says("the previous version continues to be served", 3).await;
    assert_eq!(version().await, 1);
    std::fs::write(&database, &whole).unwrap();

    // Two keyframes moved by 0.3 m together, out of five.
    let mut contents = store::load_map(&path).unwrap().contents;
    let moved: Vec<u64> = contents.keyframes[..2].iter().map(|keyframe| keyframe.id).collect();
    for keyframe in &mut contents.keyframes[..2] {
        keyframe.global_from_keyframe.pose.translation.y += 0.3;
    }
    store::save_map(&path, &contents, true).unwrap();
    signal(&server, "-HUP");
    let change = news.recv_async().await.unwrap();
    let change: MapChangeNotice = protocol::decode(Format::Bincode, &change.payload().to_bytes()).unwrap();
    assert_eq!((change.map.as_str(), change.from_version, change.version), ("hall", 1, 2));
    let motions: Vec<_> =
        change.keyframe_motions.iter().map(|motion| (motion.keyframe, motion.translation_m)).collect();
    let expected: Vec<_> = moved.iter().map(|&id| (id, [0.0_f32, 0.3, 0.0])).collect();
    for ((told, translation_m), (id, expected)) in std::iter::zip(&motions, &expected) {
        let apart = std::iter::zip(translation_m, expected).map(|(told, expected)| (told - expected).abs());
        assert!(told == id && apart.fold(0.0, f32::max) < 1e-6, "{motions:?}");
    }
    assert_eq!((motions.len(), change.moved, change.removed), (2, moved, Vec::new()));
    let stated = change.stated_change.unwrap();
    assert!((stated.sigma_p_m - 0.3 * (2.0 / 15.0_f64).sqrt()).abs() < 1e-9 && stated.sigma_theta_rad < 1e-9);
    assert_eq!(version().await, 2);
    says("replaced a map", 1).await;

    // A database that is gone does not end what is served.
    std::fs::remove_dir_all(&path).unwrap();
    signal(&server, "-HUP");
    says("the previous version continues to be served", 4).await;
    assert_eq!(version().await, 2);

    signal(&server, "-TERM");
    assert!(server.0.wait().unwrap().success());
    client.close().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_map_that_was_changed_in_two_places_is_served_under_two_numbers() {
    let directory = tempfile::tempdir().unwrap();
    let [path, copy, state, log] =
        ["hall.db", "copy.db", "state", "log"].map(|name| directory.path().join(name));
    stored_map(&path);
    testing::copy_folder(&path, &copy);
    let changed = |path: &Path, by: f64| {
        let mut contents = store::load_map(path).unwrap().contents;
        contents.keyframes[1].global_from_keyframe.pose.translation.y += by;
        assert_eq!(store::save_map(path, &contents, true).unwrap().version, 2);
    };
    changed(&path, 0.3);
    changed(&copy, -0.2);
    let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let map = format!("hall={}", path.display());
    let start = || {
        let stderr = std::fs::File::options().create(true).append(true).open(&log).unwrap();
        let mut command = program();
        command.args(["--map", &map, "--listen", &endpoint, "--state"]).arg(&state);
        Running(command.stderr(stderr).spawn().unwrap())
    };
    let options = SessionOptions { connect: vec![endpoint.clone()], ..SessionOptions::default() };
    let says = || std::fs::read_to_string(&log).unwrap().matches("changed in two places").count();
    let first_y = |path: &Path| {
        store::load_map(path).unwrap().contents.keyframes[1].global_from_keyframe.pose.translation.y
    };
    let moved_by = first_y(&copy) - first_y(&path);

    let mut server = start();
    let client = open_session(&options).await.unwrap();
    let version = async || {
        let info = ask(&client, "map/hall/info").await.unwrap();
        protocol::decode::<MapInfoReply>(Format::Bincode, &info).unwrap().version
    };
    assert_eq!(version().await, 2);
    let news = client.declare_subscriber("map/hall/changes").await.unwrap();
    let aside = directory.path().join("aside.db");
    std::fs::rename(&path, &aside).unwrap();
    std::fs::rename(&copy, &path).unwrap();
    signal(&server, "-HUP");
    let notice = tokio::time::timeout(Duration::from_mins(1), news.recv_async()).await.unwrap().unwrap();
    let notice: MapChangeNotice = protocol::decode(Format::Bincode, &notice.payload().to_bytes()).unwrap();
    assert_eq!((notice.from_version, notice.version, notice.keyframe_motions.len()), (2, 3, 1));
    let told = f64::from(notice.keyframe_motions[0].translation_m[1]);
    assert!((told - moved_by).abs() < 1e-6, "{told} m of {moved_by} m");
    assert_eq!((version().await, says()), (3, 1));

    // It stays so, also after a restart.
    signal(&server, "-HUP");
    while !std::fs::read_to_string(&log).unwrap().contains("has the version that is served") {
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    signal(&server, "-TERM");
    assert!(server.0.wait().unwrap().success());
    let mut server = start();
    assert_eq!((version().await, says()), (3, 1));
    signal(&server, "-TERM");
    assert!(server.0.wait().unwrap().success());

    // Nor is another copy, put in its place while the server is stopped, taken for what it served.
    let mut contents = store::load_map(&path).unwrap().contents;
    contents.keyframes[1].global_from_keyframe.pose.translation.y += 1.0;
    assert_eq!(store::save_map(&aside, &contents, true).unwrap().version, 3);
    std::fs::remove_dir_all(&path).unwrap();
    std::fs::rename(&aside, &path).unwrap();
    let _server = start();
    assert_eq!((version().await, says()), (4, 2));
    client.close().await.unwrap();
}
