//! How late the poses of a robot with a live camera are, what it costs, and what it does on a processor that is too slow.
//!
//! ```sh
//! cargo build --release --workspace --bins
//! cargo test --release --workspace live_latency -- --ignored --nocapture
//! ```
//! The robot is a process of its own, on processor 1 where `taskset` is installed; what plays the recording is on the others.
//! Where the ground truth is known, the odometry of each loop is scored from its initialization on.
//! `SEQUENCE` (a folder in `target/data`), `SWITCHES` (`--mode odometry --cameras mono`), `LOOPS` (1), and `BUSY` (0: programs
//! that keep the robot's processor busy: with 3 it has a quarter) in the environment change what is measured.

use anyhow::Result;
use evaluation::trajectory::{self, StateRow};
use evaluation::{ScoreOptions, score_run};
use nalgebra::Vector3;
use onboard::StopSignal;
use protocol::sensors::{ImageHeader, decode_imu};
use protocol::{Format, RobotOdometry, keys};
use sensors::{Frame, ImuSample, Recording, Sequence};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use testing::resident_mb;
use tests::data::recording;
use tests::server::Client;
use tools::in_process::free_endpoint;
use tools::playback::{NativeTopics, SensorTopics, play, wait_for_robot};
use zenoh::Wait as _;
use zenoh::sample::Sample;

const ROBOT: &str = "cart7";
/// The robot's processor.
const PROCESSOR: &str = "1";
/// Seconds without sensors between two loops of a recording: the robot initializes itself again.
const PAUSE_S: u64 = 3;
/// Images at the beginning of a run, until the estimator is initialized, are not measured: programs and caches are cold.
const WARM_UP: usize = 40;

/// A process that ends with the test.
struct Process(Child);

impl Process {
    /// Starts a program on the robot's processor.
    fn start(program: &Path, arguments: &[&str]) -> Self {
        let has_taskset = Command::new("taskset").arg("-V").stdout(Stdio::null()).status().is_ok();
        let mut command = Command::new(if has_taskset { Path::new("taskset") } else { program });
        if has_taskset {
            command.args(["-c", PROCESSOR]).arg(program);
        }
        Self(command.args(arguments).stdin(Stdio::null()).spawn().unwrap())
    }

    /// Processor time since its start, seconds.
    fn processor_s(&self) -> f64 {
        let text = std::fs::read_to_string(format!("/proc/{}/stat", self.0.id())).unwrap();
        let after_name = text.rsplit(')').next().unwrap();
        let field = |at: usize| after_name.split_whitespace().nth(at).unwrap().parse::<f64>().unwrap();
        // User and system time in ticks of 10 ms.
        (field(11) + field(12)) / 100.0
    }

    fn interrupt(&self) {
        Command::new("kill").args(["-INT", &self.0.id().to_string()]).status().unwrap();
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// When sensor data and the poses of their time arrived at a third party, which hears both over the robot's own session.
#[derive(Default)]
struct Arrivals {
    sensors: HashMap<i64, Instant>,
    delays: Vec<Duration>,
}

impl Arrivals {
    fn listen(
        client: &Client,
        sensor: String,
        pose: String,
        stamps: fn(&Sample) -> Vec<i64>,
    ) -> Arc<Mutex<Self>> {
        let arrivals = Arc::new(Mutex::new(Self::default()));
        let heard = Arc::clone(&arrivals);
        let take = move |sample: Sample| {
            let now = Instant::now();
            heard.lock().unwrap().sensors.extend(stamps(&sample).into_iter().map(|stamp_ns| (stamp_ns, now)));
        };
        client.session.declare_subscriber(sensor).callback(take).background().wait().unwrap();
        let heard = Arc::clone(&arrivals);
        let take = move |sample: Sample| {
            let now = Instant::now();
            let odometry: RobotOdometry =
                protocol::decode(Format::Json, &sample.payload().to_bytes()).unwrap();
            let mut heard = heard.lock().unwrap();
            if let Some(arrived) = heard.sensors.remove(&odometry.stamp_ns) {
                heard.delays.push(now - arrived);
            }
        };
        client.session.declare_subscriber(pose).callback(take).background().wait().unwrap();
        arrivals
    }

    fn print(&self, what: &str) {
        let mut delays: Vec<Duration> = self.delays.iter().skip(WARM_UP).copied().collect();
        delays.sort_unstable();
        assert!(!delays.is_empty(), "no {what}");
        let at = |part: f64| delays[((delays.len() - 1) as f64 * part) as usize].as_secs_f64() * 1e3;
        println!(
            "{what}: {} poses, median {:.2} ms, 99 % within {:.2}, all within {:.2}",
            delays.len(),
            at(0.5),
            at(0.99),
            at(1.0)
        );
    }
}

fn stamp_of_image(sample: &Sample) -> Vec<i64> {
    let header: ImageHeader = serde_json::from_slice(&sample.attachment().unwrap().to_bytes()).unwrap();
    vec![header.stamp_ns]
}

fn stamps_of_readings(sample: &Sample) -> Vec<i64> {
    decode_imu(&sample.payload().to_bytes()).unwrap().iter().map(|reading| reading.stamp_ns).collect()
}

/// Topics whose stamps are later than those of the recording.
struct Later<'a> {
    topics: &'a NativeTopics<'a>,
    by_ns: i64,
}

impl SensorTopics for Later<'_> {
    fn are_heard(&self) -> Result<bool> {
        self.topics.are_heard()
    }

    fn why_unheard(&self) -> Result<String> {
        self.topics.why_unheard()
    }

    fn reading(&self, reading: &ImuSample) -> Result<()> {
        self.topics.reading(&ImuSample { stamp_ns: reading.stamp_ns + self.by_ns, ..*reading })
    }

    fn frame(&self, frame: &Frame) -> Result<()> {
        self.topics.frame(&Frame { stamp_ns: frame.stamp_ns + self.by_ns, ..frame.clone() })
    }
}

/// The error and the consistency of the odometry in a loop.
fn print_score(turn: u64, states: &[StateRow], by_ns: i64, sequence: &Sequence) {
    let Some(truth) = &sequence.groundtruth else { return };
    let original = |row: &StateRow| StateRow { stamp_ns: row.stamp_ns - by_ns, ..row.clone() };
    let states: Vec<StateRow> = states.iter().map(original).collect();
    match score_run(&states, truth, -Vector3::z(), &ScoreOptions::default()) {
        Ok(score) => println!(
            "loop {turn}: {} states, aligned {:.4} m, NEES {:.2}",
            score.local.samples,
            score.odometry_yaw_aligned_m.rmse,
            score.local.nees_pose.unwrap_or(f64::NAN)
        ),
        Err(error) => println!("loop {turn}: {error}"),
    }
}

fn number(name: &str, default: u64) -> u64 {
    std::env::var(name).map_or(default, |text| text.parse().unwrap())
}

/// The robot program, which is built beside the tests.
fn onboard_program() -> PathBuf {
    let program = std::env::current_exe().unwrap().parent().unwrap().parent().unwrap().join("onboard");
    assert!(program.is_file(), "{} is missing: build it with `cargo build --bins`", program.display());
    program
}

#[test]
#[ignore = "a measurement, and needs the recordings in target/data"]
fn how_late_the_poses_of_a_live_camera_are() {
    let text = |name: &str, default: &str| std::env::var(name).unwrap_or_else(|_| default.to_owned());
    let path = recording(&text("SEQUENCE", "images/mh_01_handheld_16s"));
    let switches = text("SWITCHES", "--mode odometry --cameras mono");
    let sequence = Sequence::open(&path).unwrap();
    let played = Recording::from(&sequence);
    let (endpoint, out) = (free_endpoint().unwrap(), tempfile::tempdir().unwrap());
    let run = out.path().join("run");
    let mut arguments = vec!["--source", "native", "--robot", ROBOT, "--listen", &endpoint];
    arguments.extend(["--calibration", path.to_str().unwrap(), "--out", run.to_str().unwrap()]);
    arguments.extend(switches.split_whitespace());
    let mut robot = Process::start(&onboard_program(), &arguments);
    let spin = ["-c", "while :; do :; done"];
    let busy = (0..number("BUSY", 0)).map(|_| Process::start(Path::new("sh"), &spin));
    let busy: Vec<Process> = busy.collect();

    let (driver, third) = (Client::open(&[], &[&endpoint]), Client::open(&[], &[&endpoint]));
    let odometry = keys::robot_odometry(ROBOT).unwrap();
    let images = keys::robot_camera(ROBOT, 0).unwrap();
    let of_images = Arrivals::listen(&third, images, odometry, stamp_of_image);
    let (imu, predicted) = (keys::robot_imu(ROBOT).unwrap(), keys::robot_odometry_predicted(ROBOT).unwrap());
    let of_readings = Arrivals::listen(&third, imu, predicted, stamps_of_readings);
    let topics =
        NativeTopics::new(&driver.session, driver.runtime.handle(), ROBOT, 2, played.contents()).unwrap();
    let stop = StopSignal::default();
    std::thread::sleep(Duration::from_secs(1));
    assert_eq!(robot.0.try_wait().unwrap(), None, "the robot ended");
    wait_for_robot(&topics, &stop).unwrap();

    let first_ns = sequence.frames.first().unwrap().stamp_ns;
    let length_ns = sequence.frames.last().unwrap().stamp_ns - first_ns;
    let between_loops_ns = length_ns + PAUSE_S as i64 * 1_000_000_000;
    let (before_s, begin) = (robot.processor_s(), Instant::now());
    let (mut images, mut memory) = (0, Vec::new());
    for turn in 0..number("LOOPS", 1) {
        let later = Later { topics: &topics, by_ns: turn as i64 * between_loops_ns };
        images += play(&later, &mut played.source().unwrap(), 1.0, 0, &stop).unwrap().frames;
        memory.push(resident_mb(robot.0.id()).unwrap());
        std::thread::sleep(Duration::from_secs(PAUSE_S));
    }
    let share = (robot.processor_s() - before_s) / begin.elapsed().as_secs_f64();
    robot.interrupt();
    let ended = Instant::now();
    while !run.join("summary.json").is_file() && ended.elapsed() < Duration::from_secs(30) {
        std::thread::sleep(Duration::from_millis(50));
    }
    let summary: serde_json::Value =
        serde_json::from_slice(&std::fs::read(run.join("summary.json")).unwrap()).unwrap();

    of_images.lock().unwrap().print("image to odometry");
    of_readings.lock().unwrap().print("reading to predicted odometry");
    println!(
        "{} images in {:.0} s, {} dropped, {} restarts; {:.0} % of a processor, {} ms a frame",
        images,
        begin.elapsed().as_secs_f64(),
        summary["dropped_frames"],
        summary["reinitializations"],
        100.0 * share,
        summary["milliseconds_per_frame"]["total"],
    );
    let states = trajectory::states::read(&run.join("states.csv")).unwrap();
    for turn in 0..number("LOOPS", 1) {
        print_score(turn, &states, turn as i64 * between_loops_ns, &sequence);
    }
    println!("resident after each loop, MB: {memory:.0?}");
    drop(busy);
    driver.close();
    third.close();
}
