//! `driftless run --open`: the page while the robot runs, and afterwards. The part in a browser is skipped, with a line that says
//! so, where no Chromium is installed.

use crate::browser::{Browser, installed};
use futures_util::StreamExt as _;
use serde_json::Value;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{ExitStatus, Stdio};
use std::sync::OnceLock;
use std::time::Duration;
use tokio::io::{AsyncBufReadExt as _, AsyncReadExt as _, AsyncWriteExt as _, BufReader, Lines};
use tokio::net::TcpStream;
use tokio::process::{Child, ChildStderr, ChildStdout, Command};
use tokio::time::timeout;
use tokio_tungstenite::connect_async;
use tokio_tungstenite::tungstenite::Message;

const PATIENCE: Duration = Duration::from_mins(2);

/// A recording and the map of another, made once.
struct Place {
    folder: tempfile::TempDir,
}

impl Place {
    fn shared() -> &'static Self {
        static SHARED: OnceLock<Place> = OnceLock::new();
        SHARED.get_or_init(|| {
            let folder = tempfile::tempdir().unwrap();
            let place = Self { folder };
            let (town, map) = (place.path("town"), place.path("town.db"));
            driftless(&["simulate", "--out", text(&town), "--duration", "12"]);
            let recording = town.join("map");
            driftless(&[
                "build-map",
                text(&recording),
                "--map",
                text(&map),
                "--sigma-pixel",
                "1",
                "--gravity",
                "0,0,-1",
            ]);
            place
        })
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn driftless(arguments: &[&str]) {
    let output =
        std::process::Command::new(env!("CARGO_BIN_EXE_driftless")).args(arguments).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// `driftless run --open` in real time, on a machine without a display.
struct Running {
    process: Child,
    out: Lines<BufReader<ChildStdout>>,
    errors: ChildStderr,
    address: String,
    folder: PathBuf,
}

impl Running {
    async fn start(name: &str, arguments: &[&str]) -> Self {
        let place = tokio::task::spawn_blocking(Place::shared).await.unwrap();
        let (recording, folder) = (place.path("town/live"), place.path(name));
        let mut process = Command::new(env!("CARGO_BIN_EXE_driftless"))
            .args(["run", text(&recording), "--init", "truth", "--out", text(&folder)])
            .args(["--open", "--realtime"])
            .args(arguments)
            .env_remove("DISPLAY")
            .env_remove("WAYLAND_DISPLAY")
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .kill_on_drop(true)
            .spawn()
            .unwrap();
        let mut out = BufReader::new(process.stdout.take().unwrap()).lines();
        let errors = process.stderr.take().unwrap();
        let url = timeout(PATIENCE, out.next_line()).await.unwrap().unwrap().unwrap();
        let address = url.strip_prefix("http://").expect("the address comes first").to_owned();
        Self { process, out, errors, address, folder }
    }

    async fn get(&self, path: &str) -> Value {
        let mut stream = TcpStream::connect(&self.address).await.unwrap();
        let request = format!("GET {path} HTTP/1.1\r\nHost: {}\r\nConnection: close\r\n\r\n", self.address);
        stream.write_all(request.as_bytes()).await.unwrap();
        let mut response = String::new();
        stream.read_to_string(&mut response).await.unwrap();
        serde_json::from_str(response.split_once("\r\n\r\n").unwrap().1).unwrap()
    }

    /// The first update of which something is true.
    async fn update(&self, is_it: impl Fn(&Value) -> bool) -> Value {
        let waiting = async {
            let (mut socket, _) = connect_async(format!("ws://{}/api/live", self.address)).await.unwrap();
            loop {
                let Message::Text(text) = socket.next().await.unwrap().unwrap() else { continue };
                let update: Value = serde_json::from_str(&text).unwrap();
                if is_it(&update) {
                    return update;
                }
            }
        };
        timeout(PATIENCE, waiting).await.unwrap()
    }

    /// Whether the run has not ended.
    fn is_under_way(&self) -> bool {
        !self.folder.join("summary.json").exists()
    }

    /// Ends it by Ctrl-C.
    ///
    /// Returns its status, and what it printed on both streams.
    async fn interrupt(mut self) -> (ExitStatus, String, String) {
        assert!(self.process.try_wait().unwrap().is_none(), "it stays until Ctrl-C");
        let process = self.process.id().unwrap().to_string();
        assert!(Command::new("kill").args(["-INT", &process]).status().await.unwrap().success());
        let (mut printed, mut complaints) = (String::new(), String::new());
        let ending = async {
            while let Some(line) = self.out.next_line().await.unwrap() {
                printed += &(line + "\n");
            }
            self.errors.read_to_string(&mut complaints).await.unwrap();
            self.process.wait().await.unwrap()
        };
        let status = timeout(PATIENCE, ending).await.unwrap();
        (status, printed, complaints)
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_page_shows_the_robot_while_it_runs_and_the_whole_run_afterwards() {
    let map = Place::shared().path("town.db");
    let running = Running::start("in_map", &["--map", text(&map)]).await;
    let update = running
        .update(|update| {
            let robot = &update["robots"][0];
            robot["status"]["state"] == "localized"
                && robot["pose"].is_object()
                && robot["odometry"].is_object()
        })
        .await;
    assert!(running.is_under_way(), "it is seen while it runs");
    let robot = &update["robots"][0];
    assert_eq!((&robot["robot"], &robot["pose"]["map"]), (&"robot".into(), &"map".into()));
    let queries = running.get("/api/queries?robot=robot").await;
    assert!(!queries["queries"][0]["candidates"].as_array().unwrap().is_empty(), "{queries}");
    assert_eq!(running.get("/api/maps").await["is_run"], false);

    let ended = running.update(|update| update["run"].is_string()).await;
    assert!(!running.is_under_way(), "{ended}");
    let run = running.get("/api/run").await;
    let poses = run["global"].as_array().unwrap();
    assert!(poses.len() > 100 && poses.iter().any(|pose| pose["error_m"].is_array()), "{}", poses.len());
    // What was seen meanwhile is still there.
    let history = running.get("/api/history").await;
    assert!(history["robots"][0]["samples"].as_array().unwrap().len() > 5, "{history}");
    let (status, printed, complaints) = running.interrupt().await;
    assert!(status.success(), "{complaints}");
    assert!(printed.contains("errors against truth"), "{printed}");
    assert!(
        complaints.contains("no browser was opened") && complaints.contains("until Ctrl-C"),
        "{complaints}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn without_a_map_the_page_shows_odometry_and_ctrl_c_ends_the_run() {
    let running = Running::start("odometry", &["--mode", "odometry"]).await;
    assert_eq!(running.get("/api/maps").await["maps"], Value::Array(Vec::new()));
    running
        .update(|update| {
            let robot = &update["robots"][0];
            robot["status"]["state"] == "odometry_only" && robot["odometry"]["speed_mps"].as_f64() > Some(0.5)
        })
        .await;
    assert!(running.is_under_way());
    let (status, _, complaints) = running.interrupt().await;
    assert!(!status.success() && complaints.contains("ended early"), "{complaints}");
}

#[tokio::test(flavor = "multi_thread")]
async fn in_a_browser_the_robot_moves_while_it_runs() {
    let Some(program) = installed() else {
        let _ = writeln!(std::io::stderr(), "skipped: no Chromium is installed (apt-get install chromium)");
        return;
    };
    let map = Place::shared().path("town.db");
    let mut browser = Browser::start(&program, 1280, 800).await;
    let running = Running::start("in_browser", &["--map", text(&map)]).await;
    browser.prefer("light").await;
    browser.open(&format!("http://{}/", running.address)).await;
    browser.wait_for("window.driftless?.robots.robot?.state === 'localized'").await;
    browser
        .wait_for("window.driftless.robots.robot.trail > 3 && window.driftless.robots.robot.answers > 0")
        .await;
    assert!(running.is_under_way(), "it is seen while it runs");
    let picture = |name: &str| Path::new(env!("CARGO_MANIFEST_DIR")).join("../target/viewer").join(name);
    browser.save_picture(&picture("run_live.png")).await;

    browser.wait_for("document.getElementById('switch').hidden === false").await;
    assert!(!running.is_under_way());
    browser.wait_for("document.querySelector('.robot .state').textContent.includes('off')").await;
    browser.press("v").await;
    browser.wait_for("document.getElementById('clock')?.value.includes(' of ')").await;
    browser.wait_for("window.driftless.isReady").await;
    browser.save_picture(&picture("run_ended.png")).await;
    // And back, where the queries are.
    browser.press("v").await;
    browser.wait_for("Boolean(window.driftless?.isConnected)").await;
    browser.press("q").await;
    browser.wait_for("document.querySelectorAll('.query').length > 3").await;
    assert!(browser.complaints.is_empty(), "{:?}", browser.complaints);
    let is_foreign = |request: &String| request.starts_with("http") && !request.contains(&running.address);
    assert!(!browser.requests.iter().any(is_foreign), "{:?}", browser.requests);
    assert!(running.interrupt().await.0.success());
}
