//! A robot with live sensors over Zenoh, beside the same robot with the recording.

use geometry::pose::Pose;
use onboard::native::{NativeSensors, NativeStreams};
use onboard::{Outcome, RobotLink, StopSignal, run_robot, run_source_until};
use protocol::sensors::decode_imu;
use protocol::{RobotOdometry, keys};
use sensors::live::{LiveFrames, LiveSettings, LiveSource, Stream};
use sensors::{Recording, SensorCalibration};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use tests::robot::arguments;
use tests::scenario::MappedScenario;
use tests::server::{Client, Server};
use tools::playback::{NativeTopics, play, wait_for_robot};

const ROBOT: &str = "cart7";
/// Length of the stretch that is played, nanoseconds.
const STRETCH_NS: i64 = 6_000_000_000;
/// Nothing waits longer for the robot, whatever is wrong.
const GIVE_UP: Duration = Duration::from_mins(2);

/// When readings and the poses that are predicted to them arrived at a third party, by stamp.
#[derive(Default)]
struct Arrivals {
    readings: BTreeMap<i64, Instant>,
    predictions: Vec<(Instant, RobotOdometry)>,
}

/// Plays a recording through the server's router into a robot with live sensors.
fn live(
    recording: &Recording<'_>,
    server: &Server,
    settings: &LiveSettings,
    out: &Path,
) -> (Outcome, Arrivals) {
    let calibration: SensorCalibration = recording.calibration().clone();
    let (inputs, mut source) = LiveSource::new("test", calibration, settings);
    let robot = Client::connect(server.endpoint());
    let streams = match settings.frames {
        LiveFrames::Images => vec![Stream::Imu, Stream::Camera(0), Stream::Camera(1)],
        _ => vec![Stream::Imu, Stream::Tracks],
    };
    let subscribed = NativeSensors::subscribe(
        &robot.session,
        robot.runtime.handle(),
        ROBOT,
        &NativeStreams::new(streams),
        &inputs,
    )
    .unwrap();
    let (arrivals, third) = (Arc::new(Mutex::new(Arrivals::default())), Client::connect(server.endpoint()));
    let listeners =
        [keys::robot_imu(ROBOT).unwrap(), keys::robot_odometry_predicted(ROBOT).unwrap()].map(|key| {
            let arrivals = Arc::clone(&arrivals);
            let take = move |sample: zenoh::sample::Sample| {
                let (now, payload) = (Instant::now(), sample.payload().to_bytes());
                let mut arrivals = arrivals.lock().unwrap();
                if sample.key_expr().as_str().ends_with("imu") {
                    let readings = decode_imu(&payload).unwrap();
                    arrivals.readings.extend(readings.iter().map(|reading| (reading.stamp_ns, now)));
                } else {
                    arrivals
                        .predictions
                        .push((now, protocol::decode(protocol::Format::Json, &payload).unwrap()));
                }
            };
            third
                .runtime
                .block_on(async { third.session.declare_subscriber(key).callback(take).await })
                .unwrap()
        });
    let arguments = arguments(out, &format!("--robot {ROBOT} --cameras stereo"));
    let (stop, frames) = (StopSignal::default(), AtomicUsize::new(0));
    let link = Some(RobotLink::Open(robot.link("ring")));
    let outcome = std::thread::scope(|scope| {
        let running = scope.spawn(|| {
            run_source_until(&stop, &mut source, &arguments, link, |index| {
                frames.store(index + 1, Ordering::Relaxed);
            })
        });
        let driver = Client::open(&[], &[server.endpoint()]);
        let topics =
            NativeTopics::new(&driver.session, driver.runtime.handle(), ROBOT, 2, recording.contents())
                .unwrap();
        wait_for_robot(&topics, &stop).unwrap();
        let published = play(&topics, &mut recording.source().unwrap(), 1.0, 0, &stop).unwrap();
        let begin = Instant::now();
        while frames.load(Ordering::Relaxed) < published.frames && begin.elapsed() < GIVE_UP {
            std::thread::sleep(Duration::from_millis(20));
        }
        stop.stop();
        drop(topics);
        driver.close();
        running.join().unwrap().unwrap()
    });
    drop((subscribed, listeners));
    robot.close();
    third.close();
    let arrivals = std::mem::take(&mut *arrivals.lock().unwrap());
    (outcome, arrivals)
}

/// Poses at the rate of the IMU, in order, near those of the images.
fn check_predictions(arrivals: &Arrivals, outcome: &Outcome) {
    let predictions: Vec<&RobotOdometry> =
        arrivals.predictions.iter().map(|(_, odometry)| odometry).collect();
    assert!(predictions.is_sorted_by(|a, b| a.stamp_ns < b.stamp_ns));
    let states = outcome.states().unwrap();
    let first_ns = states[0].stamp_ns;
    let readings = arrivals.readings.range(first_ns..).count();
    assert!(predictions.len() * 10 > readings * 7, "{} of {readings}", predictions.len());
    for odometry in &predictions {
        let later = states.iter().find(|state| state.stamp_ns >= odometry.stamp_ns);
        let Some(state) = later else { break };
        let from_state = odometry.local_from_imu.pose.translation - state.local_from_imu.pose.translation;
        assert!(from_state.norm() < 0.5, "{from_state}");
    }
    let mut delays: Vec<Duration> = arrivals
        .predictions
        .iter()
        .filter_map(|(at, odometry)| {
            Some(at.saturating_duration_since(*arrivals.readings.get(&odometry.stamp_ns)?))
        })
        .collect();
    delays.sort_unstable();
    println!("{} predictions, median delay {:?}", delays.len(), delays[delays.len() / 2]);
    println!("95 %: {:?}", delays[delays.len() * 95 / 100]);
}

#[test]
fn a_robot_with_live_tracks_does_what_it_does_with_the_recording() {
    let scenario = MappedScenario::shared();
    let sequence = &scenario.recordings.live;
    let first_ns = sequence.frames[0].stamp_ns;
    let recording = Recording::from(sequence).between(first_ns, first_ns + STRETCH_NS);
    let server = Server::start("ring", scenario.loaded());

    let folder = tempfile::tempdir().unwrap();
    let client = Client::connect(server.endpoint());
    let switches = arguments(&folder.path().join("offline"), "--cameras stereo");
    let offline = run_robot(recording.clone(), &switches, Some(client.link("ring")), |_| {}).unwrap();
    client.close();

    let mut settings = LiveSettings::images(recording.calibration());
    settings.frames = LiveFrames::Tracks { features: true };
    // However busy the machine is.
    settings.max_waiting_frames = 1000;
    let (live, arrivals) = live(&recording, &server, &settings, &folder.path().join("live"));
    server.stop();
    check_predictions(&arrivals, &live);

    assert_eq!(live.summary.ended_early, None);
    let stamps =
        |outcome: &Outcome| outcome.states().unwrap().iter().map(|state| state.stamp_ns).collect::<Vec<_>>();
    assert_eq!(live.summary.dropped_frames, 0);
    assert_eq!(stamps(&live), stamps(&offline), "every frame is used");
    assert_eq!(live.summary.queries.sent, offline.summary.queries.sent);
    assert_eq!(live.summary.queries.accepted, offline.summary.queries.accepted);
    assert!(live.summary.queries.accepted > 0);
    let last = |outcome: &Outcome| -> Pose { outcome.states().unwrap().last().unwrap().local_from_imu.pose };
    let (of_live, of_offline) = (last(&live), last(&offline));
    let distance = (of_live.translation - of_offline.translation).norm();
    assert!(distance < 0.02, "{distance} m apart");
}
