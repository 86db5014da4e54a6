//! Bad input is an error that names the thing, and never more than that.

use estimator::{CalibratedCamera, Estimator, MapAnswer, Rejection};
use evaluation::{ScoreOptions, score_run};
use nalgebra::Vector3;
use odometry::EstimatorSupervisor;
use onboard::arguments::Init;
use onboard::start::initial_state;
use protocol::{
    DescriptorKind, Descriptors, ErrorCode, FeatureSet, Format, LocalizeReply, LocalizeRequest, MapInfoReply,
    MatchOutcome, MatchReply, MatchedKeyframe,
};
use recognition::{LoadedMap, RecognitionOptions};
use robot::map_conversion::map_answer;
use robot::{Robot, RobotSettings};
use sensors::{Recording, Sequence, writer};
use tests::network::{messages, only_error};
use tests::robot::{arguments, assert_every_frame_has_a_state, images, request, run};
use tests::scenario::MappedScenario;
use tests::server::{Client, Server};

/// Writes the beginning of a recording, spoils one file, and returns what opening it says.
fn complaint(file: &str, spoil: impl Fn(String) -> Option<String>) -> String {
    let mut short = MappedScenario::shared().recordings.live.clone();
    short.frames.truncate(20);
    let end_ns = short.frames[19].stamp_ns;
    short.imu_samples.retain(|sample| sample.stamp_ns <= end_ns);
    let folder = tempfile::tempdir().unwrap();
    writer::write(&short, folder.path()).unwrap();
    assert_eq!(Sequence::open(folder.path()).unwrap().frames, short.frames);
    let path = folder.path().join(file);
    match spoil(std::fs::read_to_string(&path).unwrap()) {
        Some(text) => std::fs::write(&path, text).unwrap(),
        None => std::fs::remove_file(&path).unwrap(),
    }
    let error = Sequence::open(folder.path()).unwrap_err().to_string();
    assert!(error.contains(file), "the file is not named: {error}");
    error
}

/// Replaces one cell of one line, both counted from 0.
fn with_cell(text: &str, line: usize, column: usize, value: &str) -> String {
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    let mut cells: Vec<&str> = lines[line].split(',').collect();
    cells[column] = value;
    lines[line] = cells.join(",");
    lines.join("\n") + "\n"
}

#[test]
fn a_spoiled_recording_is_refused_with_file_and_line() {
    let imu = "mav0/imu0/data.csv";
    let error = complaint(imu, |text| Some(text[..text.trim_end().rfind(',').unwrap()].to_owned()));
    assert!(error.contains("line ") && error.contains("cut off"), "{error}");
    let error = complaint("mav0/cam0/features.csv", |text| Some(text[..text.len() - 10].to_owned()));
    assert!(error.contains("line ") && error.contains("cut off"), "{error}");
    let error = complaint(imu, |text| {
        let mut lines: Vec<&str> = text.lines().collect();
        let middle = lines.len() / 2;
        lines[1..].rotate_left(middle);
        Some(lines.join("\n") + "\n")
    });
    assert!(error.contains("line ") && error.contains("sort the file"), "{error}");
    let error = complaint(imu, |text| Some(with_cell(&text, 4, 5, "NaN")));
    assert!(error.contains("line 5"), "{error}");
    for calibration in ["mav0/imu0/sensor.yaml", "mav0/cam0/sensor.yaml", "mav0/cam1/sensor.yaml"] {
        let error = complaint(calibration, |_| None);
        assert!(error.contains("missing"), "{error}");
    }
}

#[test]
fn a_reading_that_is_no_number_is_dropped_and_the_run_goes_on() {
    // A driver that feeds the estimator directly is checked there, not by a file reader.
    let mut live = MappedScenario::shared().recordings.live.clone();
    let middle = live.imu_samples.len() / 2;
    live.imu_samples[middle].accelerometer.y = f64::NAN;
    live.imu_samples[middle + 400].stamp_ns -= 50_000_000;
    let folder = tempfile::tempdir().unwrap();
    let outcome = run(&live, folder.path(), "--mode odometry", None);
    assert_eq!(outcome.summary.dropped_imu, 2);
    assert_every_frame_has_a_state(&outcome, &live);
    let (truth, options) = (live.groundtruth.as_deref().unwrap(), ScoreOptions::default());
    let score = score_run(&outcome.states().unwrap(), truth, -Vector3::z(), &options).unwrap();
    assert!(score.odometry_yaw_aligned_m.rmse < 0.5, "{score:?}");
}

#[test]
fn a_robot_that_asks_for_an_unknown_map_is_told_so_and_goes_on() {
    let scenario = MappedScenario::shared();
    let live = &scenario.recordings.live;
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start("ring", scenario.loaded());
    let client = Client::connect(server.endpoint());
    let outcome = run(live, folder.path(), "", Some(client.link("cellar")));
    assert_every_frame_has_a_state(&outcome, live);
    let events = outcome.events().unwrap();
    assert!(!events.is_empty());
    for event in &events {
        assert_eq!(event.outcome, "failed", "{event:?}");
        assert!(event.reason.contains("cellar") && event.reason.contains("ring"), "{event:?}");
    }
    assert!(outcome.summary.score.unwrap().odometry_yaw_aligned_m.rmse < 0.5);
    client.close();
    server.stop();
}

#[test]
fn a_name_that_no_key_can_hold_is_refused_before_the_run() {
    let scenario = MappedScenario::shared();
    let folder = tempfile::tempdir().unwrap();
    let client = Client::open(&[], &[]);
    let (live, out) = (&scenario.recordings.live, folder.path());
    let refused = |switches: &str, map: &str| {
        let result = onboard::run_robot(live, &arguments(out, switches), Some(client.link(map)), |_| {});
        format!("{:#}", result.unwrap_err())
    };
    assert!(refused("", "a/b").contains("a/b"));
    assert!(refused("--robot x*", "ring").contains("x*"));
    assert!(refused("--deadline=-1", "ring").contains("--deadline"));
    let mut blind = live.clone();
    blind.imu = None;
    let error = onboard::run_robot(&blind, &arguments(out, ""), None, |_| {}).unwrap_err();
    assert!(error.to_string().contains("no IMU"), "{error}");
    client.close();
}

#[test]
fn hostile_queries_are_answered_with_errors_and_the_server_lives_on() {
    let scenario = MappedScenario::shared();
    let live = &scenario.recordings.live;
    let server = Server::start("ring", scenario.loaded());
    let client = Client::connect(server.endpoint());
    let good = request(live, images(live)[5]);
    let payload = protocol::encode(Format::Bincode, &good).unwrap();
    let ask = |key: &str, payload: Vec<u8>| client.ask(key, Some(payload));

    let mut old = payload.clone();
    old[4..6].copy_from_slice(&99_u16.to_le_bytes());
    let error = only_error(&ask("map/ring/match", old));
    assert_eq!(error.code, ErrorCode::SchemaMismatch);
    assert!(error.message.contains("99"), "{error}");

    let mut long = payload.clone();
    long[8..12].copy_from_slice(&u32::MAX.to_le_bytes());
    assert_eq!(only_error(&ask("map/ring/match", long)).code, ErrorCode::BadRequest);
    // The envelope is right, but the number of bytes of the robot's name inside is not.
    let mut inner = payload.clone();
    inner[16..25].copy_from_slice(&[253, 255, 255, 255, 255, 255, 255, 255, 127]);
    let error = only_error(&ask("map/ring/match", inner));
    assert_eq!(error.code, ErrorCode::BadRequest);
    assert_eq!(only_error(&ask("map/ring/match", payload[..40].to_vec())).code, ErrorCode::BadRequest);
    let hostile = br#"{"schema":5,"type":"match_request","robot":"x","stamp_ns":1e999}"#.to_vec();
    assert_eq!(only_error(&ask("map/ring/match", hostile)).code, ErrorCode::BadRequest);
    let other = protocol::encode(Format::Bincode, &good).unwrap();
    let error = only_error(&ask("map/ring/localize", other));
    assert!(error.message.contains("localize_request"), "{error}");

    let error = only_error(&ask("map/cellar/match", payload.clone()));
    assert_eq!(error.code, ErrorCode::UnknownMap);
    assert!(error.message.contains("cellar") && error.message.contains("ring"), "{error}");

    let mut narrow = good.clone();
    let bytes = narrow.features.descriptors.bytes[..16 * narrow.features.len()].to_vec();
    narrow.features.descriptors = Descriptors { kind: DescriptorKind::Binary, width: 16, bytes };
    let error = only_error(&ask("map/ring/match", protocol::encode(Format::Bincode, &narrow).unwrap()));
    assert_eq!(error.code, ErrorCode::DescriptorMismatch);
    assert!(error.message.contains("16") && error.message.contains("32"), "{error}");

    let mut empty = good.clone();
    let descriptors = Descriptors { kind: DescriptorKind::Binary, width: 32, bytes: Vec::new() };
    empty.features = FeatureSet { pixels: Vec::new(), descriptors, extractor: String::new() };
    let replies: Vec<MatchReply> =
        messages(ask("map/ring/match", protocol::encode(Format::Bincode, &empty).unwrap()));
    let [MatchReply::Done(status)] = replies.as_slice() else { panic!("{replies:?}") };
    assert_eq!(status.outcome, MatchOutcome::TooFewFeatures);
    let nothing = LocalizeRequest {
        camera: empty.camera.clone(),
        features: empty.features.clone(),
        prior: None,
        gravity_in_camera: None,
    };
    let replies: Vec<LocalizeReply> =
        messages(ask("map/ring/localize", protocol::encode(Format::Bincode, &nothing).unwrap()));
    assert!(replies[0].fix.is_none() && replies[0].outcome == MatchOutcome::TooFewFeatures);

    let replies: Vec<MatchReply> = messages(ask("map/ring/match", payload));
    assert!(replies.len() > 1 && matches!(replies.last(), Some(MatchReply::Done(_))));
    let info: Vec<MapInfoReply> = messages(client.ask("map/ring/info", None));
    assert_eq!(info[0].keyframes as usize, scenario.map.keyframes.len());
    assert!(!server.statistics().panicked);
    client.close();
    server.stop();
}

/// What the map says to one image, without a network.
fn answer_of(map: &LoadedMap, sequence: &Sequence, frame: usize) -> MapAnswer {
    let request = request(sequence, frame);
    let mut keyframes: Vec<MatchedKeyframe> = Vec::new();
    for reply in map.answer(&request, &RecognitionOptions::default()).unwrap() {
        match reply {
            MatchReply::Keyframe(keyframe) => keyframes.push(keyframe),
            MatchReply::Done(status) => {
                return map_answer(0, &request.features, &request.held, &status, keyframes);
            }
        }
    }
    panic!("an answer without an end");
}

fn estimator(sequence: &Sequence) -> Estimator {
    let config = arguments("unused".as_ref(), "")
        .estimator_config(&sequence.calibration(), sequence.contents())
        .unwrap();
    let initial = initial_state(&sequence.into(), Init::Static, &config).unwrap().unwrap();
    Estimator::new(config, rig(sequence), &initial).unwrap()
}

fn rig(sequence: &Sequence) -> Vec<CalibratedCamera> {
    let rig = sequence.cameras.iter();
    rig.map(|eye| CalibratedCamera::new(eye.camera.clone(), eye.imu_from_camera)).collect()
}

/// Odometry up to the image after the last of `frames`; every image's clone is handed out.
fn odometry(
    sequence: &Sequence,
    frames: usize,
    pinned: Option<usize>,
) -> (Estimator, Vec<Option<estimator::CloneId>>) {
    let mut estimator = estimator(sequence);
    let (begin_ns, mut next) = (estimator.stamp_ns(), 0);
    let mut clones = Vec::new();
    for (index, frame) in sequence.frames.iter().take(frames).enumerate() {
        if frame.stamp_ns < begin_ns {
            clones.push(None);
            continue;
        }
        while next == 0 || sequence.imu_samples[next - 1].stamp_ns < frame.stamp_ns {
            estimator.imu(sequence.imu_samples[next]).unwrap();
            next += 1;
        }
        let clone = estimator.time_update(frame.stamp_ns).unwrap();
        if pinned == Some(index) {
            estimator.pin(clone);
        }
        estimator.track_update(&frame.tracks).unwrap();
        clones.push(Some(clone));
    }
    (estimator, clones)
}

#[test]
fn an_answer_that_comes_too_late_is_reported_and_does_no_harm() {
    let scenario = MappedScenario::shared();
    let live = &scenario.recordings.live;
    let map = LoadedMap::from_contents(scenario.map.clone()).unwrap();
    let asked = images(live).into_iter().find(|&frame| frame > 30).unwrap();
    let answer = answer_of(&map, live, asked);
    let frames = asked + 30;

    let (mut patient, clones) = odometry(live, frames, Some(asked));
    let report = patient.map_update(clones[asked].unwrap(), &answer).unwrap();
    assert_eq!(report.rejection, None, "a clone that is pinned waits for its answer");
    assert!(report.initialized && patient.global_from_imu().is_some());

    let (mut late, clones) = odometry(live, frames, None);
    let (pose, status) = (late.local_from_imu(), late.status());
    let report = late.map_update(clones[asked].unwrap(), &answer).unwrap();
    assert_eq!(report.rejection, Some(Rejection::TooLate));
    assert!(report.rejection.unwrap().to_string().contains("too late"));
    assert_eq!((late.local_from_imu(), late.status()), (pose, status));
    assert!(late.global_from_imu().is_none() && late.held_keyframes().is_empty());

    // It goes on as if nothing had come.
    let mut rest = live.clone();
    rest.frames.drain(..frames);
    let last_ns = live.frames[frames - 1].stamp_ns;
    rest.imu_samples.retain(|sample| sample.stamp_ns > last_ns + 5_000_000);
    let recording = Recording::from(&rest);
    let mut source = recording.source().unwrap();
    let settings = RobotSettings::new(late.config().clone());
    let supervisor = EstimatorSupervisor::running(late, rig(live));
    let report = Robot::with_estimator(&mut source, supervisor, settings).unwrap().run(|_| {});
    assert!(report.ended_early.is_none(), "{report:?}");
    assert_eq!(report.frames, rest.frames.len());
}
