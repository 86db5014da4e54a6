//! An IMU whose driver hands out its last reading again and again.

use onboard::arguments::Mode;
use onboard::{Outcome, RobotArguments, run_robot};
use sensors::Sequence;
use simulation::{Scenario, SimulationOptions, simulate};

/// Since when, seconds of the recording.
const BEGIN_S: f64 = 15.0;

fn drive() -> Sequence {
    let options = SimulationOptions {
        seed: 3,
        scenario: Scenario::Loops,
        speed: 2.0,
        duration_s: Some(30.0),
        live_feature_period_s: 1e9,
        ..SimulationOptions::default()
    };
    simulate(&options).unwrap().live
}

/// The odometry of a drive whose IMU repeats a reading for so many seconds.
fn run(drive: &Sequence, seconds: f64) -> Outcome {
    let mut drive = drive.clone();
    let begin_ns = drive.frames[0].stamp_ns + (BEGIN_S * 1e9) as i64;
    let end_ns = begin_ns + (seconds * 1e9) as i64;
    let mut last = None;
    for reading in
        drive.imu_samples.iter_mut().filter(|reading| (begin_ns..end_ns).contains(&reading.stamp_ns))
    {
        let held = last.get_or_insert(*reading);
        (reading.gyroscope, reading.accelerometer) = (held.gyroscope, held.accelerometer);
    }
    let folder = tempfile::tempdir().unwrap();
    let mut arguments = RobotArguments::with_defaults(&folder.path().join("out")).unwrap();
    arguments.mode = Some(Mode::Odometry);
    run_robot(&drive, &arguments, None, |_| {}).unwrap()
}

#[test]
fn a_repeated_reading_is_an_alarm_and_no_motion() {
    let drive = drive();
    let errors = |outcome: &Outcome| {
        let score = outcome.summary.score.as_ref().unwrap();
        (score.odometry_yaw_aligned_m.rmse, score.local.nees_pose.unwrap())
    };
    let whole = run(&drive, 0.0);
    assert_eq!(whole.summary.alarms, []);
    let (without_m, _) = errors(&whole);
    for seconds in [0.5, 2.0, 5.0] {
        let outcome = run(&drive, seconds);
        let (error_m, nees) = errors(&outcome);
        println!(
            "{seconds} s: {error_m:.3} m, NEES {nees:.2}, without {without_m:.3} m; {:?}",
            outcome.summary.alarms
        );
        let [alarm] = &outcome.summary.alarms[..] else { panic!("{:?}", outcome.summary.alarms) };
        assert!(alarm.reason.contains("repeats one reading"), "{alarm:?}");
        assert!((BEGIN_S..BEGIN_S + 0.3).contains(&alarm.seconds), "{alarm:?}");
        assert!(alarm.ended_s.is_some_and(|ended_s| ended_s < BEGIN_S + seconds + 0.3), "{alarm:?}");
        assert!(nees < 1.5 && error_m < 1.5 * without_m, "{error_m} m, NEES {nees}");
        assert!(outcome.summary.divergences.is_empty());
    }
}
