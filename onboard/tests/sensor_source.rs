//! A robot plays any sensor source, not only recordings.

use nalgebra::{UnitQuaternion, Vector3};
use onboard::arguments::{Init, Mode};
use onboard::{RobotArguments, StopSignal, run_robot, run_source_until};
use sensors::{Contents, Frame, ImuSample, Sequence};
use sensors::{SensorCalibration, SensorError, SensorEvent, SensorSource};
use simulation::{SimulationOptions, simulate};

/// A generator: it makes each event when it is asked for, from a place in two lists.
struct Generator<'a> {
    sequence: &'a Sequence,
    calibration: SensorCalibration,
    readings: usize,
    frames: usize,
    /// Number of events after which the device is lost.
    lost_after: usize,
    /// Ticks before the first measurement, as of a live source.
    ticks: usize,
}

impl<'a> Generator<'a> {
    fn new(sequence: &'a Sequence) -> Self {
        let calibration = sequence.calibration();
        Self { sequence, calibration, readings: 0, frames: 0, lost_after: usize::MAX, ticks: 0 }
    }

    fn next_reading(&mut self, until_ns: i64) -> Option<ImuSample> {
        let reading = *self.sequence.imu_samples.get(self.readings)?;
        (reading.stamp_ns <= until_ns).then(|| {
            self.readings += 1;
            reading
        })
    }
}

impl SensorSource for Generator<'_> {
    fn name(&self) -> &'static str {
        "generator"
    }

    fn calibration(&self) -> &SensorCalibration {
        &self.calibration
    }

    fn contents(&self) -> Contents {
        Contents { tracks: true, ..Contents::default() }
    }

    fn next(&mut self) -> Result<Option<SensorEvent>, SensorError> {
        if self.ticks > 0 {
            self.ticks -= 1;
            return Ok(Some(SensorEvent::Tick));
        }
        if self.readings + self.frames >= self.lost_after {
            let source = "the device was unplugged".into();
            return Err(SensorError::Source { name: "generator".to_owned(), source });
        }
        let frame = self.sequence.frames.get(self.frames);
        if let Some(reading) = self.next_reading(frame.map_or(i64::MAX, |frame| frame.stamp_ns)) {
            return Ok(Some(SensorEvent::Imu(reading)));
        }
        self.frames += 1;
        Ok(frame.cloned().map(SensorEvent::Frame))
    }
}

fn recorded() -> Sequence {
    let options = SimulationOptions { duration_s: Some(15.0), ..SimulationOptions::default() };
    simulate(&options).unwrap().live
}

fn arguments(out: &std::path::Path) -> RobotArguments {
    let mut arguments = RobotArguments::with_defaults(out).unwrap();
    arguments.mode = Some(Mode::Odometry);
    arguments
}

#[test]
fn a_generator_gives_the_same_states_as_a_recording_of_its_events() {
    let sequence = recorded();
    let folder = tempfile::tempdir().unwrap();
    let (played, generated) = (folder.path().join("played"), folder.path().join("generated"));
    let stop = StopSignal::default();
    let mut generator = Generator::new(&sequence);
    let outcome = run_source_until(&stop, &mut generator, &arguments(&generated), None, |_| {}).unwrap();
    let reference = run_robot(&sequence, &arguments(&played), None, |_| {}).unwrap();
    assert!(outcome.summary.frames > 100, "{} frames", outcome.summary.frames);
    assert_eq!(outcome.states().unwrap(), reference.states().unwrap());
    assert_eq!(outcome.summary.sequence, "generator");
    assert!(outcome.summary.score.is_none() && reference.summary.score.is_some());
}

#[test]
fn a_source_that_fails_ends_the_run_with_its_error_and_leaves_the_states() {
    let sequence = recorded();
    let folder = tempfile::tempdir().unwrap();
    let mut generator = Generator::new(&sequence);
    generator.lost_after = 2100;
    let (stop, arguments) = (StopSignal::default(), arguments(folder.path()));
    let outcome = run_source_until(&stop, &mut generator, &arguments, None, |_| {}).unwrap();
    assert_eq!(outcome.summary.ended_early.as_deref(), Some("generator: the device was unplugged"));
    assert!(outcome.states().unwrap().len() > 50);
}

#[test]
fn switches_that_need_a_recording_are_refused() {
    let sequence = recorded();
    let folder = tempfile::tempdir().unwrap();
    let mut arguments = arguments(folder.path());
    arguments.init = Init::Truth;
    let mut generator = Generator::new(&sequence);
    let error = run_source_until(&StopSignal::default(), &mut generator, &arguments, None, |_| {});
    assert!(error.unwrap_err().to_string().contains("generator is not a recording"));
}

#[test]
fn a_gyroscope_in_degrees_is_an_alarm_once_the_robot_moves_and_not_before() {
    let in_degrees = |seconds_of_rest: i64| {
        let mut sequence = swinging(seconds_of_rest);
        sequence.imu_samples.iter_mut().for_each(|sample| sample.gyroscope *= 1_f64.to_degrees());
        let folder = tempfile::tempdir().unwrap();
        let mut generator = Generator::new(&sequence);
        let arguments = arguments(folder.path());
        run_source_until(&StopSignal::default(), &mut generator, &arguments, None, |_| {}).unwrap().summary
    };
    let summary = in_degrees(15);
    // At 57 times its rate, the start of the motion is a jump.
    let [jump, alarm] = &summary.alarms[..] else { panic!("{:?}", summary.alarms) };
    assert!(jump.reason.contains("bad readings") && jump.ended_s.is_some(), "{jump:?}");
    assert!(alarm.reason.contains("the rates are in deg/s") && alarm.ended_s.is_none(), "{alarm:?}");
    assert!((15.0..27.0).contains(&alarm.seconds), "{alarm:?}");
    assert!(summary.final_status.unwrap().reason.contains("deg/s"));
    assert_eq!(in_degrees(40).alarms, []);
}

/// A robot at rest for some seconds, and then swinging, 40 s in all; it has no tracks.
fn swinging(seconds_of_rest: i64) -> Sequence {
    let mut sequence = recorded();
    let rotation = |seconds: f64| {
        let angle = (seconds - seconds_of_rest as f64).max(0.0);
        UnitQuaternion::from_scaled_axis(Vector3::new((1.1 * angle).sin(), (0.8 * angle).cos() - 1.0, 0.0))
    };
    let reading = |k: i64| {
        let (step, here) = (0.005, rotation(k as f64 * 0.005));
        ImuSample {
            stamp_ns: k * 5_000_000,
            gyroscope: (here.inverse() * rotation((k + 1) as f64 * step)).scaled_axis() / step,
            accelerometer: here.inverse() * (Vector3::z() * 9.81),
        }
    };
    sequence.imu_samples = (0..8000).map(reading).collect();
    let frame = Frame { tracks: Vec::new(), stamp_ns: 0, ..sequence.frames[0].clone() };
    sequence.frames = (1..400).map(|k| Frame { stamp_ns: k * 100_000_000, ..frame.clone() }).collect();
    sequence
}

#[test]
fn diagnostics_before_the_first_frame_have_the_time_of_the_sensors() {
    let sequence = recorded();
    let folder = tempfile::tempdir().unwrap();
    let mut generator = Generator::new(&sequence);
    generator.ticks = 3;
    let mut arguments = arguments(&folder.path().join("out"));
    arguments.record = Some(folder.path().join("run.mcap"));
    run_source_until(&StopSignal::default(), &mut generator, &arguments, None, |_| {}).unwrap();
    let bag = bags::Bag::open(&folder.path().join("run.mcap")).unwrap();
    let topic = bag.topics().iter().find(|topic| topic.name == "/diagnostics").unwrap();
    let first_ns = sequence.frames[0].stamp_ns;
    let stamps = || {
        topic.messages.iter().map(|message| {
            let message = bag.read(message.place).unwrap();
            let array: ros_messages::diagnostic_msgs::DiagnosticArray =
                ros_messages::decode(&message).unwrap();
            array.header.stamp.to_nanoseconds()
        })
    };
    assert_eq!(stamps().filter(|stamp_ns| *stamp_ns < first_ns).count(), 3);
    assert!(stamps().all(|stamp_ns| stamp_ns > first_ns - 60_000_000_000));
}
