//! The robot program from outside: what it leaves when it is stopped, killed, or its output is closed.

use client::{SessionOptions, close_session, open_session};
use evaluation::trajectory::{states, tum};
use protocol::{Presence, Published};
use sensors::writer;
use simulation::{SimulationOptions, simulate};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use zenoh::sample::{Sample, SampleKind};

/// Within this time of a signal a robot has ended.
const END: Duration = Duration::from_secs(3);

/// Readings that are missing in the middle of the recording, at 200 a second.
const LOST: std::ops::Range<usize> = 1000..1020;

/// Writes a recording of 200 frames in twenty seconds.
fn record(folder: &Path) {
    let options = SimulationOptions { duration_s: Some(21.0), ..SimulationOptions::default() };
    let mut sequence = simulate(&options).unwrap().live;
    sequence.frames.truncate(200);
    sequence.imu_samples.drain(LOST);
    writer::write(&sequence, folder).unwrap();
}

/// A recording, and a session that listens, with its address.
async fn recorded_beside_a_session() -> (tempfile::TempDir, zenoh::Session, String) {
    let folder = tempfile::tempdir().unwrap();
    record(folder.path());
    let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let options = SessionOptions { listen: vec![endpoint.clone()], ..SessionOptions::default() };
    (folder, open_session(&options).await.unwrap(), endpoint)
}

fn start(recording: &Path, out: &Path, switches: &[&str]) -> Child {
    Command::new(env!("CARGO_BIN_EXE_onboard"))
        .args(["--mode", "odometry", "--init", "truth", "--sequence"])
        .arg(recording)
        .arg("--out")
        .arg(out)
        .args(switches)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

/// Waits until a run has written states, then sends a signal, and waits for its end.
fn signal(mut child: Child, out: &Path, name: &str) -> ExitStatus {
    wait_for_states(&mut child, out);
    let sent = Command::new("kill").args([name, &child.id().to_string()]).status().unwrap();
    assert!(sent.success());
    child.wait().unwrap()
}

/// Processors that have nothing else to do, so that the robot has none of its own.
struct Load {
    is_over: Arc<AtomicBool>,
    busy: Vec<std::thread::JoinHandle<()>>,
}

impl Load {
    fn start() -> Load {
        let is_over = Arc::new(AtomicBool::new(false));
        let count = 3 * std::thread::available_parallelism().unwrap().get();
        let spin = |is_over: Arc<AtomicBool>| {
            while !is_over.load(Ordering::Relaxed) {
                std::hint::spin_loop();
            }
        };
        let busy = (0..count)
            .map(|_| {
                let is_over = Arc::clone(&is_over);
                std::thread::spawn(move || spin(is_over))
            })
            .collect();
        Load { is_over, busy }
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
        for thread in self.busy.drain(..) {
            thread.join().unwrap();
        }
    }
}

/// Waits until a run has written states.
fn wait_for_states(child: &mut Child, out: &Path) {
    let written =
        || std::fs::read_to_string(out.join("states.csv")).is_ok_and(|text| text.lines().count() > 10);
    while !written() {
        assert!(child.try_wait().unwrap().is_none(), "the run ended before it wrote anything");
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// Sends SIGTERM to a run, which must end soon, and as a whole.
fn ends_soon(mut child: Child, out: &Path) {
    assert!(Command::new("kill").args(["-TERM", &child.id().to_string()]).status().unwrap().success());
    let begin = Instant::now();
    while child.try_wait().unwrap().is_none() {
        assert!(begin.elapsed() < END, "it did not end");
        std::thread::sleep(Duration::from_millis(10));
    }
    assert_eq!(summary(out)["interrupted"], true);
}

#[test]
fn a_robot_under_load_ends_soon_after_a_signal() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    record(folder.path());
    let mut child = start(folder.path(), &out, &["--realtime"]);
    let _load = Load::start();
    wait_for_states(&mut child, &out);
    ends_soon(child, &out);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_whose_server_is_silent_ends_soon_after_a_signal() {
    let (folder, session, endpoint) = recorded_beside_a_session().await;
    let out = folder.path().join("out");
    let (hold, held) = std::sync::mpsc::channel();
    let silent = session.declare_queryable("map/hall/match").callback(move |query| hold.send(query).unwrap());
    let _silent = silent.await.unwrap();
    for switches in [&[][..], &["--realtime"]] {
        let child = Command::new(env!("CARGO_BIN_EXE_onboard"))
            .args(["--init", "truth", "--map", "hall", "--deadline", "60", "--connect", &endpoint])
            .arg("--sequence")
            .arg(folder.path())
            .arg("--out")
            .arg(&out)
            .args(switches)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let query = held.recv_timeout(Duration::from_mins(1)).unwrap();
        tokio::task::block_in_place(|| ends_soon(child, &out));
        drop(query);
        held.try_iter().for_each(drop);
        std::fs::remove_dir_all(&out).unwrap();
    }
    close_session(&session).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_says_that_it_is_shut_down_and_one_that_is_killed_does_not() {
    let (folder, session, endpoint) = recorded_beside_a_session().await;
    let out = folder.path().join("out");
    for (name, is_off) in [("-TERM", true), ("-KILL", false)] {
        let presence = Arc::new(Mutex::new(None::<Presence>));
        let heard = Arc::clone(&presence);
        let note = move |sample: Sample| {
            let (now, mut presence) = (Instant::now(), heard.lock().unwrap());
            let presence = presence.get_or_insert_with(|| Presence::new(now));
            presence.note_token(sample.kind() == SampleKind::Put, now);
        };
        let _token = session.liveliness().declare_subscriber("robot/ada").callback(note).await.unwrap();
        let heard = Arc::clone(&presence);
        let note = move |sample: Sample| {
            let (key, encoding) = (sample.key_expr().as_str(), sample.encoding().to_string());
            let published = Published::decode(key, &encoding, &sample.payload().to_bytes()).unwrap();
            let (now, mut presence) = (Instant::now(), heard.lock().unwrap());
            presence.get_or_insert_with(|| Presence::new(now)).note_published(&published, now);
        };
        let _status = session.declare_subscriber("robot/ada/status").callback(note).await.unwrap();
        let child = Command::new(env!("CARGO_BIN_EXE_onboard"))
            .args([
                "--init",
                "truth",
                "--map",
                "hall",
                "--robot",
                "ada",
                "--realtime",
                "--connect",
                &endpoint,
            ])
            .arg("--sequence")
            .arg(folder.path())
            .arg("--out")
            .arg(&out)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let wait_for = async |is_wanted: &dyn Fn(&Presence) -> bool| {
            let begin = Instant::now();
            while !presence.lock().unwrap().as_ref().is_some_and(is_wanted) {
                assert!(begin.elapsed() < Duration::from_secs(20), "{name}: {presence:?}");
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
        };
        wait_for(&|presence| presence.is_online(Instant::now())).await;
        tokio::task::block_in_place(|| signal(child, &out, name));
        wait_for(&|presence| presence.has_ended() && presence.is_off() == is_off).await;
        // Nothing that is on its way says something else.
        tokio::time::sleep(Duration::from_millis(500)).await;
        let presence = presence.lock().unwrap().unwrap();
        assert!(presence.is_off() == is_off && !presence.is_online(Instant::now()), "{name}: {presence:?}");
        std::fs::remove_dir_all(&out).unwrap();
    }
    close_session(&session).await;
}

fn summary(out: &Path) -> serde_json::Value {
    serde_json::from_str(&std::fs::read_to_string(out.join("summary.json")).unwrap()).unwrap()
}

#[test]
fn an_old_name_of_a_switch_ends_with_the_present_one() {
    let folder = tempfile::tempdir().unwrap();
    let settings = folder.path().join("robot.yaml");
    std::fs::write(&settings, "sequence: drive\nstate-landmarks: 20\n").unwrap();
    let settings = settings.to_string_lossy().into_owned();
    for (line, said) in [
        (&["--sequence", "drive", "--settings", "filter.yaml"][..], "the switch is --estimator-config"),
        (&["--sequence", "drive", "--track-sigma=1.5", "--out", "out"], "the switch is --sigma-track"),
        (&["--source", "native", "--config", "zenoh.json5"], "the switch is --zenoh-config"),
        (&[settings.as_str()], "slam-features"),
    ] {
        let output = Command::new(env!("CARGO_BIN_EXE_onboard")).args(line).output().unwrap();
        let error = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && error.contains(said), "{line:?}: {error}");
        assert_eq!(error.lines().count(), 1, "{line:?}: {error}");
    }
}

#[test]
fn a_run_that_is_interrupted_leaves_complete_files() {
    for name in ["-INT", "-TERM"] {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("out");
        record(folder.path());
        let status = signal(start(folder.path(), &out, &["--realtime"]), &out, name);
        assert_eq!(status.code(), Some(1), "a run that ended early has failed");
        let summary = summary(&out);
        assert_eq!(summary["interrupted"], true);
        assert!(summary["ended_early"].as_str().unwrap().contains("interrupted"), "{summary}");
        assert!(!summary["final_status"].is_null());
        let rows = states::read(&out.join("states.csv")).unwrap();
        assert!(rows.len() >= 10 && rows.len() < 200, "{}", rows.len());
        assert_eq!(summary["frames"], rows.len());
        assert_eq!(summary["score"]["local"]["samples"], rows.len());
        assert_eq!(tum::read(&out.join("odometry.tum")).unwrap().len(), rows.len());
    }
}

#[test]
fn a_run_that_is_killed_leaves_what_it_had() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    record(folder.path());
    // The summary of an earlier run must not be taken for this one's.
    std::fs::create_dir(&out).unwrap();
    std::fs::write(out.join("summary.json"), "{}").unwrap();
    assert!(!signal(start(folder.path(), &out, &["--realtime"]), &out, "-KILL").success());
    assert!(!out.join("summary.json").exists());
    let text = std::fs::read_to_string(out.join("states.csv")).unwrap();
    // A full buffer is written up to the middle of a line.
    let whole = &text[..=text.rfind('\n').unwrap()];
    std::fs::write(out.join("states.csv"), whole).unwrap();
    assert!(states::read(&out.join("states.csv")).unwrap().len() >= 9);
}

#[test]
fn a_complete_run_reports_its_gaps() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    record(folder.path());
    let output = start(folder.path(), &out, &[]).wait_with_output().unwrap();
    assert!(output.status.success());
    let summary = summary(&out);
    assert_eq!((&summary["interrupted"], &summary["frames"]), (&false.into(), &200.into()));
    assert_eq!(summary["imu_gaps"]["count"], 1);
    assert!((summary["imu_gaps"]["longest_s"].as_f64().unwrap() - 0.105).abs() < 1e-9);
    let log = String::from_utf8(output.stderr).unwrap();
    assert_eq!(log.matches("a gap in the IMU's readings").count(), 1, "{log}");
}

#[test]
fn a_recording_beside_topics_of_ros_is_not_played_and_that_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let child = start(Path::new("drive"), &folder.path().join("out"), &["--source", "ros2"]);
    let output = child.wait_with_output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    // Before anything is missing that live sensors need.
    assert!(!output.status.success() && said.contains("--imu-topic is missing"), "{said}");
    assert!(said.contains("--source ros2 takes live sensors: this recording is not played"), "{said}");
}

#[test]
fn a_closed_pipe_is_no_panic() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    record(folder.path());
    let mut child = start(folder.path(), &out, &["--json", "--duration", "2"]);
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(141));
    assert!(!String::from_utf8(output.stderr).unwrap().contains("panicked"));
    assert!(out.join("summary.json").exists());
}
