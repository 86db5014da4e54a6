//! A robot that is carried elsewhere while its cameras are covered.

use estimator::Localization;
use onboard::Outcome;
use protocol::{Format, RobotState, RobotStatus};
use sensors::Sequence;
use simulation::{Scenario, SimulationOptions};
use std::ops::Range;
use std::sync::OnceLock;
use tests::robot::run;
use tests::scenario::MappedScenario;
use tests::server::{Client, Server};

/// When the cameras are covered, seconds of the recording.
const COVERED_S: Range<f64> = 20.0..40.0;

fn scenario() -> &'static MappedScenario {
    static SCENARIO: OnceLock<MappedScenario> = OnceLock::new();
    SCENARIO.get_or_init(|| {
        MappedScenario::of(&SimulationOptions {
            seed: 3,
            scenario: Scenario::Loops,
            speed: 2.0,
            max_tracks: 60,
            duration_s: Some(60.0),
            live_feature_period_s: 0.5,
            ..SimulationOptions::default()
        })
    })
}

/// What is missing while the cameras are covered.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Missing {
    /// Images are dark: nothing is tracked in them.
    Tracks,
    /// There are no images.
    Images,
    /// Nor are there readings of the IMU.
    ImagesAndImu,
}

/// The recording with something missing while the cameras are covered, in which the robot moves on by 40 m.
fn covered(missing: Missing) -> Sequence {
    let mut sequence = scenario().recordings.live.clone();
    let first_ns = sequence.frames[0].stamp_ns;
    let is_covered = |stamp_ns: i64| COVERED_S.contains(&((stamp_ns - first_ns) as f64 * 1e-9));
    for frame in sequence.frames.iter_mut().filter(|frame| is_covered(frame.stamp_ns)) {
        frame.tracks.clear();
        frame.features.clear();
    }
    sequence.frames.retain(|frame| missing == Missing::Tracks || !is_covered(frame.stamp_ns));
    sequence.imu_samples.retain(|reading| missing != Missing::ImagesAndImu || !is_covered(reading.stamp_ns));
    sequence
}

/// The states that the robot published, each once in a row, and the result of its run.
fn carried(missing: Missing) -> (Vec<RobotState>, Outcome) {
    let sequence = covered(missing);
    let server = Server::start("ring", scenario().loaded());
    let client = Client::connect(server.endpoint());
    let (sender, receiver) = std::sync::mpsc::channel();
    let said = move |sample: zenoh::sample::Sample| {
        let status: RobotStatus = protocol::decode(Format::Json, &sample.payload().to_bytes()).unwrap();
        sender.send(status.state).unwrap();
    };
    let subscriber = client.session.declare_subscriber("robot/ada/status").callback(said);
    let subscriber = client.runtime.block_on(async { subscriber.await }).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let outcome = run(&sequence, folder.path(), "--robot ada", Some(client.link("ring")));
    drop(subscriber);
    client.close();
    server.stop();
    let mut states: Vec<RobotState> = receiver.iter().collect();
    states.dedup();
    assert_eq!(states.pop(), Some(RobotState::Off), "it was shut down in order");

    // Localized at the end, where it is, with all answers from three seconds after the light on.
    let last = outcome.states().unwrap().last().unwrap().clone();
    let truth = sequence.groundtruth.as_ref().unwrap().last().unwrap();
    let off = (last.global_from_imu.unwrap().pose.translation - truth.pose.translation).norm();
    assert!(off < 0.2, "{missing:?}: {off} m");
    let begin_s = sequence.frames[0].stamp_ns as f64 * 1e-9;
    let events = outcome.events().unwrap();
    let later = || events.iter().filter(|event| event.queried_at_s - begin_s > COVERED_S.end + 3.0);
    assert!(later().count() > 20 && later().all(|event| event.accepted), "{missing:?}: {events:?}");
    (states, outcome)
}

#[test]
fn a_robot_that_only_its_imu_carried_on_is_localized_by_the_first_answer() {
    for missing in [Missing::Tracks, Missing::Images] {
        let (states, outcome) = carried(missing);
        // Its covariance grew, and was right: it was never lost.
        assert_eq!(states, [RobotState::Starting, RobotState::OdometryOnly, RobotState::Localized]);
        assert_eq!(outcome.summary.starts.len(), 1);
        assert_eq!(outcome.summary.alarms, []);
    }
}

#[test]
fn a_robot_without_any_sensor_says_that_it_is_lost_and_then_that_it_is_localized_again() {
    use RobotState::{Localized, Lost, OdometryOnly, Starting};
    let (states, outcome) = carried(Missing::ImagesAndImu);
    assert_eq!(states, [Starting, OdometryOnly, Localized, Lost, OdometryOnly, Localized]);
    let [divergence] = &outcome.summary.divergences[..] else { panic!("{:?}", outcome.summary.divergences) };
    assert!(divergence.reason.contains("no IMU readings for 20.0 s"), "{}", divergence.reason);
    assert_eq!(outcome.summary.final_status.unwrap().localization, Localization::Localized);
}
