//! What a run gives out, and in which order.

use estimator::Localization;
use robot::stop::StopSignal;
use robot::{Estimate, Output, Robot, RobotError, RobotSettings, RunError, RunReport, StatusReport};
use sensors::live::{LiveFrames, LiveInputs, LiveSettings, LiveSource};
use sensors::{Frame, ImuSample, Recording, SensorEvent, SensorSource as _, Sequence};
use simulation::{SimulationOptions, simulate};
use std::cell::RefCell;
use std::ops::Range;
use std::rc::Rc;
use std::time::{Duration, Instant};

/// A call of an output, with the time that it is about.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Call {
    Begin(i64),
    Frame(i64),
    Estimate(i64),
    Status(Option<i64>),
    End(usize),
}

/// Keeps what it is told.
#[derive(Clone, Debug, Default)]
struct Witness {
    calls: Vec<Call>,
    readings: Vec<i64>,
    positions: Vec<[f64; 3]>,
}

impl Output for Witness {
    fn begin(&mut self, stamp_ns: i64) {
        self.calls.push(Call::Begin(stamp_ns));
    }

    fn reading(&mut self, reading: &ImuSample) {
        self.readings.push(reading.stamp_ns);
    }

    fn frame(&mut self, frame: &Frame) {
        self.calls.push(Call::Frame(frame.stamp_ns));
    }

    fn estimate(&mut self, estimate: &Estimate) {
        self.calls.push(Call::Estimate(estimate.motion.stamp_ns));
        self.positions.push(estimate.motion.state.local_from_imu.translation.into());
    }

    fn status(&mut self, report: &StatusReport) {
        self.calls.push(Call::Status(report.stamp_ns));
    }

    fn end(&mut self, report: &RunReport) {
        self.calls.push(Call::End(report.frames));
    }
}

/// Five seconds with tracks.
fn sequence() -> Sequence {
    simulate(&SimulationOptions { duration_s: Some(5.0), ..SimulationOptions::default() }).unwrap().live
}

fn settings(sequence: &Sequence) -> RobotSettings {
    RobotSettings::new(robot::estimator_config(&sequence.calibration()).unwrap())
}

/// What a witness was told, and what the run reported.
fn run(sequence: &Sequence, settings: RobotSettings, others: usize) -> (Witness, RunReport) {
    let recording = Recording::from(sequence);
    let mut source = recording.source().unwrap();
    let mut witness = Witness::default();
    let mut robot = Robot::new(&mut source, settings).unwrap();
    for _ in 0..others {
        robot.add_output(Witness::default());
    }
    robot.add_output(&mut witness);
    let report = robot.run(|_| {});
    (witness, report)
}

#[test]
fn an_output_is_told_of_every_image_in_order_and_of_the_end() {
    let sequence = sequence();
    let (Witness { calls, readings, positions }, report) = run(&sequence, settings(&sequence), 0);
    assert!(report.ended_early.is_none(), "{report:?}");
    assert_eq!(calls.first(), Some(&Call::Begin(sequence.frames[0].stamp_ns)));
    assert_eq!(calls.last(), Some(&Call::End(report.frames)));
    let (mut frames, mut estimates) = (0, 0);
    let mut rest = &calls[1..calls.len() - 1];
    while let Some((Call::Frame(stamp_ns), behind)) = rest.split_first() {
        rest = match behind {
            [Call::Estimate(of), Call::Status(Some(state)), rest @ ..] => {
                estimates += 1;
                assert_eq!((of, state), (stamp_ns, stamp_ns));
                rest
            }
            // Before the initialization there is a status only.
            [Call::Status(Some(of)), rest @ ..] => {
                assert_eq!((of, estimates), (stamp_ns, 0));
                rest
            }
            other => panic!("{other:?}"),
        };
        frames += 1;
    }
    assert_eq!(rest, []);
    assert_eq!((frames, estimates, positions.len()), (sequence.frames.len(), report.frames, report.frames));
    assert!(report.frames > frames / 2);
    let first: Vec<i64> =
        sequence.imu_samples.iter().take(readings.len()).map(|reading| reading.stamp_ns).collect();
    assert_eq!(readings, first, "every reading comes once and in order");
}

#[test]
fn who_listens_does_not_change_what_is_said() {
    let sequence = sequence();
    let [(alone, _), (third, _)] = [0, 2].map(|others| run(&sequence, settings(&sequence), others));
    assert_eq!(alone.positions, third.positions);
    assert_eq!(alone.calls, third.calls);
}

#[test]
fn outputs_are_ended_where_a_run_is_stopped() {
    let sequence = sequence();
    let mut settings = settings(&sequence);
    let stop = settings.stop.clone();
    settings.name = "cart7".to_owned();
    let recording = Recording::from(&sequence);
    let mut source = recording.source().unwrap();
    let mut witness = Witness::default();
    let mut robot = Robot::new(&mut source, settings).unwrap();
    robot.add_output(&mut witness);
    let report = robot.run(|frame| {
        if frame == 20 {
            stop.stop();
        }
    });
    assert!(matches!(report.ended_early, Some(RunError::Interrupted { .. })), "{report:?}");
    assert_eq!(witness.calls.iter().filter(|call| matches!(call, Call::Frame(_))).count(), 20);
    assert_eq!(witness.calls.last(), Some(&Call::End(report.frames)));
}

/// An output that fails at one image and works again later.
#[derive(Default)]
struct Faulty {
    frames: usize,
    /// Reasons of statuses while it fails, and otherwise.
    reasons: [Vec<String>; 2],
}

impl Faulty {
    const FAULT: &str = "the tape is torn";
}

impl Output for Faulty {
    fn frame(&mut self, _: &Frame) {
        self.frames += 1;
    }

    fn status(&mut self, report: &StatusReport) {
        let fails = self.fault().is_some();
        self.reasons[usize::from(!fails)].push(report.status.reason.clone());
    }

    fn fault(&self) -> Option<&str> {
        (30..50).contains(&self.frames).then_some(Self::FAULT)
    }
}

#[test]
fn what_is_wrong_with_an_output_is_an_alarm_and_in_the_status_as_long_as_it_lasts() {
    let sequence = sequence();
    let recording = Recording::from(&sequence);
    let mut source = recording.source().unwrap();
    let mut faulty = Faulty::default();
    let mut robot = Robot::new(&mut source, settings(&sequence)).unwrap();
    robot.add_output(Witness::default());
    robot.add_output(&mut faulty);
    let report = robot.run(|_| {});
    let [failing, working] = &faulty.reasons;
    assert_eq!(failing.len(), 20);
    assert!(failing.iter().all(|reason| reason.ends_with(Faulty::FAULT)), "{failing:?}");
    assert!(!working.is_empty() && working.iter().all(|reason| !reason.contains(Faulty::FAULT)));
    let alarms: Vec<_> =
        report.alarms.iter().map(|alarm| (&*alarm.reason, alarm.ended_s.is_some())).collect();
    assert_eq!(alarms, [(Faulty::FAULT, true)]);
}

/// Says when it is dropped.
struct Dropped(&'static str, Rc<RefCell<Vec<&'static str>>>);

impl Output for Dropped {}

impl Drop for Dropped {
    fn drop(&mut self) {
        self.1.borrow_mut().push(self.0);
    }
}

#[test]
fn outputs_are_dropped_in_the_order_in_which_they_were_added() {
    let sequence = sequence();
    let recording = Recording::from(&sequence);
    let mut source = recording.source().unwrap();
    let mut robot = Robot::new(&mut source, settings(&sequence)).unwrap();
    let dropped = Rc::new(RefCell::new(Vec::new()));
    for name in ["recording", "publisher"] {
        robot.add_output(Dropped(name, Rc::clone(&dropped)));
    }
    assert!(robot.run(|_| {}).ended_early.is_none());
    assert_eq!(*dropped.borrow(), ["recording", "publisher"]);
}

#[test]
fn a_robot_without_a_camera_is_refused() {
    let mut sequence = sequence();
    let settings = settings(&sequence);
    sequence.cameras.clear();
    sequence.frames.clear();
    let recording = Recording::from(&sequence);
    let mut source = recording.source().unwrap();
    assert!(source.calibration().cameras.is_empty());
    assert!(matches!(Robot::new(&mut source, settings), Err(RobotError::NoCamera)));
}

/// Keeps the states that it is told, each once in a row, with their first reasons.
#[derive(Default)]
struct States(Vec<(Localization, String)>);

impl Output for States {
    fn status(&mut self, report: &StatusReport) {
        let status = &report.status;
        if self.0.last().is_none_or(|(last, _)| *last != status.localization) {
            self.0.push((status.localization, status.reason.clone()));
        }
    }
}

/// What is wrong with a recording in some of its seconds.
#[derive(Clone, Copy, PartialEq)]
enum Wrong {
    /// No images come.
    Images,
    /// The accelerometer gives mm/s^2.
    Readings,
}

/// Plays a recording in real time, which has a fault for some seconds since its begin.
fn play(sequence: &Sequence, inputs: &LiveInputs, wrong: Wrong, when: Range<f64>) {
    let recording = Recording::from(sequence);
    let mut source = recording.source().unwrap();
    let (begin, mut first_ns) = (Instant::now(), None);
    while let Some(event) = source.next().unwrap() {
        let Some(stamp_ns) = event.stamp_ns() else { continue };
        let seconds = (stamp_ns - *first_ns.get_or_insert(stamp_ns)) as f64 * 1e-9;
        let due = begin + Duration::from_secs_f64(seconds.max(0.0));
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
        let is_wrong = |what: Wrong| what == wrong && when.contains(&seconds);
        match event {
            SensorEvent::Imu(mut reading) => {
                if is_wrong(Wrong::Readings) {
                    reading.accelerometer *= 1000.0;
                }
                inputs.imu(reading);
            }
            SensorEvent::Frame(frame) if !is_wrong(Wrong::Images) => {
                inputs.tracks(frame.stamp_ns, frame.tracks, None);
            }
            _ => {}
        }
    }
    inputs.close();
}

/// A live source of the tracks of a recording.
fn live_source(sequence: &Sequence) -> (LiveInputs, LiveSource) {
    let calibration = Recording::from(sequence).calibration().clone();
    let mut live = LiveSettings::images(&calibration);
    live.frames = LiveFrames::Tracks { features: false };
    LiveSource::new("live", calibration, &live)
}

#[test]
fn a_live_robot_without_images_is_lost_until_the_next_one() {
    let sequence = sequence();
    let (inputs, mut source) = live_source(&sequence);
    let mut states = States::default();
    std::thread::scope(|scope| {
        scope.spawn(|| play(&sequence, &inputs, Wrong::Images, 2.5..4.2));
        let mut robot = Robot::new(&mut source, settings(&sequence)).unwrap();
        robot.add_output(&mut states);
        let _ = robot.run(|_| {});
    });
    let [.., (before, _), (without, reason), (after, _)] = &states.0[..] else { panic!("{:?}", states.0) };
    assert_eq!(
        [before, without, after],
        [&Localization::OdometryOnly, &Localization::Lost, &Localization::OdometryOnly],
        "{:?}",
        states.0
    );
    assert!(reason.starts_with("no image was used for 1."), "{reason}");
}

/// Stops its run as soon as the state is lost.
struct StopWhereLost {
    stop: StopSignal,
    lost: Option<(Instant, String)>,
}

impl Output for StopWhereLost {
    fn status(&mut self, report: &StatusReport) {
        if report.status.localization == Localization::Lost && self.lost.is_none() {
            self.lost = Some((Instant::now(), report.status.reason.clone()));
            self.stop.stop();
        }
    }
}

/// Readings in another unit are refused, and no more come for any image.
#[test]
fn a_live_robot_whose_readings_are_all_refused_is_lost_says_why_and_can_be_stopped() {
    let sequence = sequence();
    let settings = settings(&sequence);
    let (inputs, mut source) = live_source(&sequence);
    let mut output = StopWhereLost { stop: settings.stop.clone(), lost: None };
    let begin = Instant::now();
    let report = std::thread::scope(|scope| {
        scope.spawn(|| play(&sequence, &inputs, Wrong::Readings, 2.0..5.0));
        let mut robot = Robot::new(&mut source, settings).unwrap();
        robot.add_output(&mut output);
        robot.run(|_| {})
    });
    let (lost, reason) = output.lost.unwrap();
    let after_s = (lost - begin).as_secs_f64();
    assert!((3.0..4.5).contains(&after_s), "lost after {after_s:.1} s");
    assert!(reason.contains("bad readings of the IMU"), "{reason}");
    assert!(report.wall_seconds < after_s + 1.0, "stopped after {:.1} s", report.wall_seconds);
    assert!(report.alarms.iter().any(|alarm| alarm.reason.contains("IMU")), "{:?}", report.alarms);
    assert!(report.skipped_frames > 10, "{report:?}");
}
