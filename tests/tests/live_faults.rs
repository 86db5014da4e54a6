//! What drivers do wrong, on the way from Zenoh to the published pose: each fault is named in the status within two seconds,
//! the pose stays right, and the robot goes on.
//!
//! Both tests run in real time, side by side.

use geometry::{Pose, rotation};
use nalgebra::Vector3;
use onboard::native::{NativeSensors, NativeStreams};
use onboard::{ClockShiftSummary, Outcome, RobotLink, StopSignal, run_source_until};
use protocol::sensors::ImageHeader;
use protocol::{Format, RobotState, RobotStatus, keys};
use sensors::live::{LiveFrames, LiveInputs, LiveSettings, LiveSource, Stream};
use sensors::{Frame, ImuSample, Recording, SensorEvent, SensorSource, TruthTrack};
use simulation::SimulationOptions;
use simulation::images::{ImageOptions, render_all, simulate_images};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use tests::robot::arguments;
use tests::scenario::MappedScenario;
use tests::server::{Client, Server};
use tools::in_process::free_endpoint;
use tools::playback::{NativeTopics, SensorTopics, wait_for_robot};
use vision::GrayImage;
use zenoh::Wait as _;

const ROBOT: &str = "cart7";
/// Within this time a fault is in the status.
const NAMED_WITHIN: Duration = Duration::from_secs(2);
/// Longest gap of the truth, nanoseconds.
const MAX_GAP_NS: i64 = 150_000_000;

/// What a robot published as its status, and when.
type Statuses = Arc<Mutex<Vec<(Instant, RobotStatus)>>>;

/// A robot with live sensors, and who watches it.
struct Robot {
    link: Client,
    watcher: Client,
    inputs: LiveInputs,
    source: LiveSource,
    statuses: Statuses,
    sensors: NativeSensors,
}

impl Robot {
    fn connect(endpoint: &str, recording: &Recording<'_>, settings: &LiveSettings) -> Self {
        let (inputs, source) = LiveSource::new("test", recording.calibration().clone(), settings);
        let (link, watcher) = (Client::open(&[], &[endpoint]), Client::open(&[], &[endpoint]));
        let frames = match settings.frames {
            LiveFrames::Images => Stream::Camera(0),
            _ => Stream::Tracks,
        };
        let mut streams = vec![Stream::Imu, frames];
        streams.extend((frames == Stream::Camera(0)).then_some(Stream::Camera(1)));
        let subscribed = NativeSensors::subscribe(
            &link.session,
            link.runtime.handle(),
            ROBOT,
            &NativeStreams::new(streams),
            &inputs,
        );
        let statuses = Statuses::default();
        let heard = Arc::clone(&statuses);
        let take = move |sample: zenoh::sample::Sample| {
            let status = protocol::decode(Format::Json, &sample.payload().to_bytes()).unwrap();
            heard.lock().unwrap().push((Instant::now(), status));
        };
        let key = keys::robot_status(ROBOT).unwrap();
        watcher.session.declare_subscriber(key).callback(take).background().wait().unwrap();
        Self { link, watcher, inputs, source, statuses, sensors: subscribed.unwrap() }
    }

    /// Runs the robot as long as `drive` takes.
    fn run(&mut self, switches: &str, map: Option<&str>, drive: impl FnOnce(&LiveInputs)) -> Outcome {
        let folder = tempfile::tempdir().unwrap();
        let arguments = arguments(folder.path(), &format!("--robot {ROBOT} {switches}"));
        let link = match map {
            Some(map) => RobotLink::Open(self.link.link(map)),
            None => RobotLink::Network {
                session: self.link.session.clone(),
                runtime: self.link.runtime.handle().clone(),
            },
        };
        let stop = StopSignal::default();
        let mut outcome = std::thread::scope(|scope| {
            let running =
                scope.spawn(|| run_source_until(&stop, &mut self.source, &arguments, Some(link), |_| {}));
            drive(&self.inputs);
            stop.stop();
            running.join().unwrap().unwrap()
        });
        outcome.out = folder.keep();
        outcome
    }

    /// Waits until the status has come that says that the robot was shut down.
    fn wait_for_last_status(&self) {
        let begin = Instant::now();
        let is_off = |(_, status): &(Instant, RobotStatus)| status.state == RobotState::Off;
        while !self.statuses.lock().unwrap().last().is_some_and(is_off) {
            assert!(begin.elapsed() < Duration::from_secs(10), "the robot said nothing at its end");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    fn close(self) {
        drop(self.sensors);
        self.link.close();
        self.watcher.close();
    }
}

/// Waits until a robot that is behind the sensors has got to a time, half a minute at most.
fn wait_until_at(statuses: &Statuses, stamp_ns: i64) {
    let begin = Instant::now();
    let is_there = |(_, status): &(Instant, RobotStatus)| status.stamp_ns >= stamp_ns;
    while begin.elapsed() < Duration::from_secs(30) && !statuses.lock().unwrap().last().is_some_and(is_there)
    {
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// A driver, which can be stopped and started again.
struct Driver {
    client: Client,
    topics: NativeTopics<'static>,
}

impl Driver {
    fn start(endpoint: &str, recording: &Recording<'_>) -> Self {
        let client = Client::open(&[], &[endpoint]);
        let contents = recording.contents();
        let topics = NativeTopics::new(&client.session, client.runtime.handle(), ROBOT, 2, contents).unwrap();
        wait_for_robot(&topics, &StopSignal::default()).unwrap();
        Self { client, topics }
    }

    fn stop(self) {
        let Self { client, topics } = self;
        drop(topics);
        client.close();
    }

    /// Sends an image as it is.
    fn image(&self, camera: usize, header: &ImageHeader, bytes: Vec<u8>) {
        let key = keys::robot_camera(ROBOT, camera).unwrap();
        let header = serde_json::to_vec(header).unwrap();
        self.client.session.put(key, bytes).attachment(header).wait().unwrap();
    }
}

/// When faults began, and how a status names them.
#[derive(Default)]
struct Faults(Vec<(&'static str, Instant, &'static [&'static str])>);

impl Faults {
    /// A fault begins, unless it has.
    fn begin(&mut self, fault: &'static str, named: &'static [&'static str]) {
        if !self.0.iter().any(|(begun, ..)| *begun == fault) {
            self.0.push((fault, Instant::now(), named));
        }
    }

    /// Each fault is in a status soon.
    fn assert_named(&self, statuses: &Statuses) {
        let statuses = statuses.lock().unwrap();
        for (fault, begin, named) in &self.0 {
            let soon = statuses.iter().filter(|(at, _)| *at >= *begin && *at <= *begin + NAMED_WITHIN);
            let reasons: Vec<&str> = soon.map(|(_, status)| status.reason.as_str()).collect();
            let first = reasons.iter().find(|reason| named.iter().any(|name| reason.contains(name)));
            assert!(first.is_some(), "{fault}: {:?}", reasons.last());
        }
    }
}

/// Plays a recording in real time: `each` gets every event with its seconds since the first.
fn play(recording: &Recording<'_>, mut each: impl FnMut(f64, SensorEvent)) {
    let (mut source, begin) = (recording.source().unwrap(), Instant::now());
    let mut first_ns = None;
    while let Some(event) = source.next().unwrap() {
        let Some(stamp_ns) = event.stamp_ns() else { continue };
        let seconds = (stamp_ns - *first_ns.get_or_insert(stamp_ns)) as f64 * 1e-9;
        let due = begin + Duration::from_secs_f64(seconds.max(0.0));
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
        each(seconds, event);
    }
}

fn shifted(event: &SensorEvent, shift_ns: i64) -> SensorEvent {
    match event {
        SensorEvent::Imu(reading) => {
            SensorEvent::Imu(ImuSample { stamp_ns: reading.stamp_ns + shift_ns, ..*reading })
        }
        SensorEvent::Frame(frame) => {
            SensorEvent::Frame(Frame { stamp_ns: frame.stamp_ns + shift_ns, ..frame.clone() })
        }
        _ => SensorEvent::Tick,
    }
}

fn send(topics: &dyn SensorTopics, event: &SensorEvent) {
    match event {
        SensorEvent::Imu(reading) => topics.reading(reading).unwrap(),
        SensorEvent::Frame(frame) => topics.frame(frame).unwrap(),
        _ => {}
    }
}

/// The first, not the second, third ... of a fault.
fn within(seconds: f64, from: f64, to: f64) -> bool {
    (from..to).contains(&seconds)
}

const SECOND_NS: i64 = 1_000_000_000;

#[test]
fn clocks_order_and_drivers_that_fail_do_not_move_the_pose_in_the_map() {
    let scenario = MappedScenario::shared();
    let sequence = &scenario.recordings.live;
    let first_ns = sequence.frames[0].stamp_ns;
    let recording = Recording::from(sequence).between(first_ns, first_ns + 22 * SECOND_NS);
    let server = Server::start("ring", scenario.loaded());
    let mut settings = LiveSettings::images(recording.calibration());
    settings.frames = LiveFrames::Tracks { features: true };
    // However busy the machine is.
    settings.max_waiting_frames = 1000;
    let mut robot = Robot::connect(server.endpoint(), &recording, &settings);
    let (mut faults, mut lost_order) = (Faults::default(), None);
    let outcome = robot.run("--cameras stereo", Some("ring"), |_| {
        let mut driver = Some(Driver::start(server.endpoint(), &recording));
        let mut held: Vec<SensorEvent> = Vec::new();
        play(&recording, |seconds, event| {
            let shift_ns = match seconds {
                ..5.0 => 0,
                5.0..8.0 => SECOND_NS,
                _ => 3601 * SECOND_NS,
            };
            let event = shifted(&event, shift_ns);
            if within(seconds, 11.0, 12.5) {
                return faults.begin("nothing for 1.5 s", &["no readings for"]);
            }
            if within(seconds, 16.0, 17.5) {
                if let Some(running) = driver.take() {
                    running.stop();
                    faults.begin("the driver restarts", &["no readings for"]);
                }
                return;
            }
            let running = driver.get_or_insert_with(|| Driver::start(server.endpoint(), &recording));
            if within(seconds, 2.5, 2.8) {
                faults.begin("messages come twice", &["come twice"]);
                send(&running.topics, &event);
            }
            if within(seconds, 3.3, 3.8) {
                lost_order.get_or_insert_with(Instant::now);
                held.push(event);
                if held.len() >= 20 {
                    held.drain(..).rev().for_each(|event| send(&running.topics, &event));
                }
                return;
            }
            held.drain(..).for_each(|event| send(&running.topics, &event));
            if within(seconds, 4.2, 4.3) {
                faults.begin("readings are no JSON", &["not as documented"]);
                let reading = br#"{"stamp_ns": 7, "gyroscope": [NaN, 0, 0], "accelerometer": [0, 0, 9.81]}"#;
                running.client.session.put(keys::robot_imu(ROBOT).unwrap(), reading).wait().unwrap();
            }
            if seconds >= 5.0 {
                faults.begin("the clock jumps by 1 s", &["jumped by 0.9", "jumped by 1."]);
            }
            if seconds >= 8.0 {
                faults.begin("the clock jumps by 1 h", &["jumped by 3599.", "jumped by 3600."]);
            }
            send(&running.topics, &event);
        });
        driver.into_iter().for_each(Driver::stop);
    });
    faults.assert_named(&robot.statuses);
    robot.wait_for_last_status();
    let statuses = std::mem::take(&mut *robot.statuses.lock().unwrap());
    robot.close();
    server.stop();

    // Out of order within 200 ms is no fault, and nothing is lost.
    let since = lost_order.unwrap();
    let late = statuses.iter().find(|(at, status)| {
        *at >= since && *at <= since + NAMED_WITHIN && status.reason.contains("come after later ones")
    });
    assert!(late.is_none(), "{late:?}");
    let [.., (_, last), (_, end)] = &statuses[..] else { panic!("{statuses:?}") };
    assert_eq!((last.state, end.state), (RobotState::Localized, RobotState::Off), "{last:?}, {end:?}");
    // Where the motion is not known the robot is lost, says so, and is found again.
    let divergences = &outcome.summary.divergences;
    let is_gap = |reason: &str| reason.contains("no IMU readings for");
    assert!(divergences.len() == 2 && divergences.iter().all(|each| is_gap(&each.reason)), "{divergences:?}");
    let lost = statuses.iter().filter(|(_, status)| status.state == RobotState::Lost);
    assert!(lost.clone().any(|(_, status)| is_gap(&status.reason)), "{:?}", lost.count());

    // Times that are written are those of the sensors, jumps included.
    assert_jumps_are_written(&outcome.summary.clock_shifts);
    let truth = TruthTrack::new(sequence.groundtruth.as_deref().unwrap());
    let states = outcome.states().unwrap();
    std::fs::remove_dir_all(&outcome.out).unwrap();
    let (mut localized, mut worst) = (0, 0.0_f64);
    for state in &states {
        let Some(pose) = state.global_from_imu else { continue };
        let shift_ns = match (state.stamp_ns - first_ns) as f64 * 1e-9 {
            ..4.5 => 0,
            // Images of before the jump may come after it was noticed.
            4.5..6.5 => continue,
            ..1000.0 => SECOND_NS,
            _ => 3601 * SECOND_NS,
        };
        let Some(expected) = truth.pose(state.stamp_ns - shift_ns, MAX_GAP_NS) else { continue };
        let apart = (pose.pose.translation - expected.translation).norm();
        let sigma = pose.sigma_p_m();
        assert!(apart < 0.5 && sigma < 0.5, "{apart} m with sigma {sigma} at {}", state.stamp_ns);
        (localized, worst) = (localized + 1, worst.max(apart));
    }
    println!("{} states, {localized} localized, at most {worst:.2} m off", states.len());
    let last_ns = states.last().unwrap().stamp_ns;
    assert!(last_ns - first_ns > (3601 + 21) * SECOND_NS, "the robot went on to the end");
    assert!(localized > 130, "{localized}");
}

/// That of a second after 5 s, and the one to an hour more.
fn assert_jumps_are_written(shifts: &[ClockShiftSummary]) {
    let [first, .., last] = shifts else { panic!("{shifts:?}") };
    assert!((first.shift_s - 1.0).abs() < 0.5 && (first.seconds - 5.0).abs() < 2.0, "{first:?}");
    assert!((last.shift_s - 3601.0).abs() < 1.0, "{last:?}");
}

/// A flight through a room with stereo images.
fn flight(seconds: f64) -> sensors::Sequence {
    let options =
        SimulationOptions { duration_s: Some(seconds), frame_rate_hz: 10.0, ..ImageOptions::simulation() };
    let mut flight = simulate_images(&options, &ImageOptions::default()).unwrap().live;
    render_all(&mut flight, |_, _| {}).unwrap();
    flight
}

#[test]
fn images_and_readings_that_are_none_do_not_move_the_odometry() {
    let sequence = flight(9.5);
    let recording = Recording::from(&sequence);
    let endpoint = free_endpoint().unwrap();
    let router = Client::open(&[&endpoint], &[]);
    let mut settings = LiveSettings::images(recording.calibration());
    settings.max_waiting_frames = 1000;
    let mut robot = Robot::connect(&endpoint, &recording, &settings);
    let (mut faults, mut frozen): (_, Option<[GrayImage; 2]>) = (Faults::default(), None);
    let played_ns = sequence.frames.last().unwrap().stamp_ns;
    let statuses = Arc::clone(&robot.statuses);
    let outcome = robot.run("--cameras stereo --mode odometry", None, |inputs| {
        let driver = Driver::start(&endpoint, &recording);
        play(&recording, |seconds, event| {
            let frame = match &event {
                SensorEvent::Frame(frame) => frame,
                SensorEvent::Imu(reading) if within(seconds, 2.5, 2.6) => {
                    faults.begin("readings are not finite", &["readings are not finite"]);
                    let gyroscope = Vector3::new(f64::NAN, 0.0, 0.0);
                    inputs.imu(ImuSample { stamp_ns: reading.stamp_ns + 1_000_000, gyroscope, ..*reading });
                    return send(&driver.topics, &event);
                }
                _ => return send(&driver.topics, &event),
            };
            let [image, other] = [0, 1].map(|camera| &frame.images[&camera]);
            let (image, other) = (image.read().unwrap().into_owned(), other.read().unwrap().into_owned());
            let (width, height) = (image.width() as u32, image.height() as u32);
            let header = |encoding: &str, width, height| ImageHeader {
                stamp_ns: frame.stamp_ns,
                encoding: encoding.to_owned(),
                width,
                height,
                step: None,
            };
            if within(seconds, 3.0, 3.3) {
                faults.begin("an encoding that is none", &["h264"]);
                driver.image(0, &header("h264", width, height), image.pixels().to_vec());
            } else if within(seconds, 3.6, 3.9) {
                faults.begin("images of another size", &["320 x 240"]);
                driver.image(0, &header("mono8", 320, 240), vec![7; 320 * 240]);
            } else if within(seconds, 4.2, 4.5) {
                faults.begin("half an image", &["cannot be decoded"]);
                let png = image.to_png().unwrap();
                driver.image(0, &header("png", 0, 0), png[..png.len() / 2].to_vec());
            } else if within(seconds, 5.0, 6.4) {
                faults.begin("a frozen camera", &["the same image again and again"]);
                for (camera, frozen) in frozen.get_or_insert([image, other]).iter().enumerate() {
                    driver.image(camera, &header("mono8", width, height), frozen.pixels().to_vec());
                }
            } else {
                driver.topics.frame(frame).unwrap();
            }
        });
        driver.stop();
        wait_until_at(&statuses, played_ns - SECOND_NS / 2);
    });
    faults.assert_named(&robot.statuses);
    robot.close();
    router.close();
    assert!(outcome.summary.divergences.is_empty(), "{:?}", outcome.summary.divergences);
    let states = outcome.states().unwrap();
    std::fs::remove_dir_all(&outcome.out).unwrap();
    let (first, last) = (states.first().unwrap(), states.last().unwrap());
    assert!(played_ns - last.stamp_ns < SECOND_NS, "the robot went on to the end");

    // L has its origin and its yaw in the first pose.
    let truth = TruthTrack::new(sequence.groundtruth.as_deref().unwrap());
    let at = |stamp_ns: i64| truth.pose(stamp_ns, MAX_GAP_NS).unwrap();
    let begun = at(first.stamp_ns);
    let turn = begun.rotation * first.local_from_imu.pose.rotation.inverse();
    let yaw = rotation::exp(&(Vector3::z() * turn.scaled_axis().z));
    let origin = begun.translation - yaw * first.local_from_imu.pose.translation;
    let expected = Pose::new(yaw, origin).inverse() * at(last.stamp_ns);
    let apart = (last.local_from_imu.pose.translation - expected.translation).norm();
    let seconds = (last.stamp_ns - first.stamp_ns) as f64 * 1e-9;
    let sigma = last.local_from_imu.sigma_p_m();
    println!(
        "{apart:.2} m off, sigma {sigma:.2} m, after {seconds:.1} s of odometry, 2.3 s of them without images"
    );
    assert!(apart < 0.3 + 4.0 * sigma && sigma < 1.0, "{apart} m off, sigma {sigma} m");
}
