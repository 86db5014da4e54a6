//! Laws of what is recorded.

use super::recording_thread::{Item, record};
use super::session_builder::SessionBuilder;
use super::settings::HandInSettings;
use super::{HandInOutput, folder};
use estimator::{ImuSample, TrackObservation};
use geometry::{Camera, Distortion, Pose};
use hand_in::{Answer, AnsweredMatch, Chunk, Header, Session};
use map::sessions::RecordedDigest;
use nalgebra::{UnitQuaternion, Vector2, Vector3};
use protocol::{DescriptorKind, Descriptors, FeatureSet, MapIdentity};
use robot::Output as _;
use sensors::{CameraSensor, ImuNoise, ImuSensor};
use std::path::Path;
use std::sync::mpsc::sync_channel;
use std::time::Duration;

const IMAGE_NS: i64 = 50_000_000;

fn settings(folder: &Path, bytes_per_minute: f64, session_length: Duration) -> HandInSettings {
    let camera = Camera {
        width: 640,
        height: 480,
        focal: [400.0; 2],
        centre: [320.0, 240.0],
        distortion: Distortion::None,
    };
    let imu =
        ImuSensor { noise: ImuNoise::default(), rate_hz: 200.0, gravity_magnitude: None, intrinsics: None };
    let header = Header {
        robot: "ada".to_owned(),
        name: String::new(),
        program: "test".to_owned(),
        started_unix_s: 0,
        imu,
        cameras: vec![CameraSensor::new(camera, Pose::identity(), 20.0); 2],
    };
    let folder = folder.to_owned();
    HandInSettings {
        folder,
        header,
        key: None,
        bytes_per_minute,
        session_length,
        most_bytes: 1_000_000,
        realtime: false,
    }
}

fn reading(at: i64) -> ImuSample {
    let value = |axis: i64| ((at * 7 + axis) as f64 * 0.37).sin();
    ImuSample {
        stamp_ns: at * 5_000_000 + 1_000_000,
        gyroscope: Vector3::new(value(0), value(1), value(2)),
        accelerometer: Vector3::new(value(3), value(4), 9.81 + value(5)),
    }
}

/// A drive of some images at 20 Hz: points that are seen in 40 images each, and of every tenth image features and an answer.
fn drive(images: i64) -> Vec<Item> {
    drive_with_cameras(images, |_| vec![0])
}

/// [`drive`] in which the map is asked about other cameras.
///
/// # Arguments
/// * `asked`: the cameras that it is asked about, by the number of the image.
fn drive_with_cameras(images: i64, asked: impl Fn(i64) -> Vec<usize>) -> Vec<Item> {
    let mut items = Vec::new();
    for image in 0..images {
        let stamp_ns = image * IMAGE_NS;
        items.extend((10 * image - 10..10 * image).map(|at| Item::Reading(reading(at))));
        items.push(Item::Image(stamp_ns));
        let tracks = (0..200_u64).map(|point| {
            let feature_id = point * 1000 + (image as u64 + point) / 40;
            TrackObservation { camera: 0, feature_id, pixel: Vector2::new(point as f64 * 3.0, image as f64) }
        });
        items.push(Item::Tracks(stamp_ns, tracks.collect()));
        items.push(Item::Pose(stamp_ns, Pose::from_translation(image as f64 * 0.05)));
        if image % 10 != 0 {
            continue;
        }
        for camera in asked(image) {
            let features = FeatureSet {
                pixels: (0..500).map(|at| [at as f32, 7.0]).collect(),
                descriptors: Descriptors {
                    kind: DescriptorKind::Int8,
                    width: 64,
                    bytes: vec![(image + camera as i64) as u8; 500 * 64],
                },
                extractor: "test-1".to_owned(),
            };
            items.push(Item::Features(stamp_ns, camera, features));
            items.push(Item::Answer(Answer {
                stamp_ns,
                camera,
                map_identity: MapIdentity::from_bytes([1; 16]),
                map_version: camera as u64,
                inliers: 2,
                used: 2,
                accepted: true,
                matches: [3, 499]
                    .map(|feature| AnsweredMatch { feature, landmark: 10, keyframe: 2 })
                    .to_vec(),
            }));
        }
    }
    items
}

/// A pose along x.
trait Along {
    fn from_translation(x: f64) -> Self;
}

impl Along for Pose {
    fn from_translation(x: f64) -> Self {
        Self::new(UnitQuaternion::identity(), Vector3::new(x, 0.0, 0.0))
    }
}

fn recorded(settings: &HandInSettings, items: Vec<Item>) -> Vec<Session> {
    let (sender, receiver) = sync_channel(items.len());
    for item in items {
        sender.send(item).unwrap();
    }
    drop(sender);
    record(settings, &receiver).unwrap();
    let mut paths: Vec<_> =
        std::fs::read_dir(&settings.folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    paths.iter().map(|path| Session::open(path).unwrap()).collect()
}

const LONG: Duration = Duration::from_hours(1);

#[test]
fn a_session_has_the_identity_that_the_ledger_gives_to_the_recording() {
    let folder = tempfile::tempdir().unwrap();
    let sessions = recorded(&settings(folder.path(), 9e5, LONG), drive(400));
    assert_eq!(sessions.len(), 1);
    let mut digest = RecordedDigest::default();
    let end_ns = 399 * IMAGE_NS;
    for reading in (-10..4000).map(reading).filter(|reading| (0..end_ns).contains(&reading.stamp_ns)) {
        let [[a, b, c], [d, e, f]] = [reading.gyroscope, reading.accelerometer].map(<[f64; 3]>::from);
        digest.add_reading(reading.stamp_ns, [a, b, c, d, e, f]);
    }
    (0..400).for_each(|image| digest.add_image(image * IMAGE_NS));
    let whole = digest.finish();
    let so_far = sessions[0].recorded.clone().unwrap();
    assert_eq!(so_far.id, whole.id.to_bytes());
    assert_eq!((so_far.begin_ns, so_far.end_ns), (0, end_ns));
    let mut samples = so_far.new_samples;
    samples.sort_unstable();
    assert_eq!(samples, whole.samples.digests());
}

#[test]
fn pieces_of_a_drive_have_no_reading_in_common_and_one_motion() {
    let folder = tempfile::tempdir().unwrap();
    let sessions = recorded(&settings(folder.path(), 9e5, Duration::from_secs(10)), drive(700));
    assert!(sessions.len() >= 3, "{}", sessions.len());
    let mut samples: Vec<u64> = Vec::new();
    for session in &sessions {
        let so_far = session.recorded.clone().unwrap();
        assert!(so_far.new_samples.iter().all(|sample| !samples.contains(sample)));
        samples.extend(so_far.new_samples);
        assert!(session.readings[0].stamp_ns <= session.frames[0].stamp_ns + 5_000_000);
        assert!(session.is_ended);
    }
    for pair in sessions.windows(2) {
        assert!(pair[0].frames.last().unwrap().stamp_ns < pair[1].frames[0].stamp_ns);
    }
}

#[test]
fn a_minute_takes_no_more_than_its_budget_and_candidates_have_what_was_matched() {
    for bytes_per_minute in [4e5, 9e5] {
        let folder = tempfile::tempdir().unwrap();
        let sessions = recorded(&settings(folder.path(), bytes_per_minute, LONG), drive(2400));
        let session = &sessions[0];
        let of_minute = session.whole_bytes as f64 / session.seconds() * 60.0;
        assert!(of_minute < bytes_per_minute * 1.05, "{of_minute} of {bytes_per_minute}");
        assert!(session.candidates() > 5, "{}", session.candidates());
        assert_eq!(session.answers.len(), session.candidates());
        for answer in &session.answers {
            assert_has_what_was_matched(session, answer);
        }
        let intervals = session.frames.windows(2).map(|pair| pair[1].stamp_ns - pair[0].stamp_ns);
        assert!(intervals.max().unwrap() <= 300_000_000);
        let long = session.frames.iter().map(|frame| frame.tracks.len()).max().unwrap();
        assert!(long > 40 && long <= 80, "{long}");
    }
}

/// An answer names features of the candidate that it is about.
fn assert_has_what_was_matched(session: &Session, answer: &Answer) {
    let frame = session.frames.iter().find(|frame| frame.stamp_ns == answer.stamp_ns).unwrap();
    let candidate = frame.candidates.iter().find(|candidate| candidate.camera == answer.camera).unwrap();
    let features = &candidate.features;
    assert!(features.len() <= 250);
    // The pixel says which feature it was.
    let of_matches = answer.matches.iter().map(|found| features.pixels[found.feature as usize][0]);
    assert_eq!(of_matches.collect::<Vec<_>>(), [3.0, 499.0]);
}

/// Settings of a robot with a camera that looks ahead, a stereo pair to the left and a camera that looks back.
fn surround_settings(folder: &Path, bytes_per_minute: f64) -> HandInSettings {
    let mut settings = settings(folder, bytes_per_minute, LONG);
    let first = settings.header.cameras[0].clone();
    let turned = |angle: f64| {
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), angle);
        CameraSensor { imu_from_camera: Pose::new(rotation, Vector3::zeros()), ..first.clone() }
    };
    settings.header.cameras = [0.0, 1.6, 1.6, 3.1].map(turned).to_vec();
    settings
}

#[test]
fn every_camera_that_the_map_is_asked_about_has_candidates_within_one_budget() {
    // In turn, all at once, and one of them more often.
    let in_turn = |image: i64| vec![[0, 1, 3][(image / 10 % 3) as usize]];
    let at_once = |_: i64| vec![0, 1, 3];
    let mostly_ahead = |image: i64| vec![[0, 1, 0, 3][(image / 10 % 4) as usize]];
    let drives: [&dyn Fn(i64) -> Vec<usize>; 3] = [&in_turn, &at_once, &mostly_ahead];
    for asked in drives {
        for bytes_per_minute in [4e5, 9e5] {
            let folder = tempfile::tempdir().unwrap();
            let of_robot = surround_settings(folder.path(), bytes_per_minute);
            let sessions = recorded(&of_robot, drive_with_cameras(2400, asked));
            let session = &sessions[0];
            let of_minute = session.whole_bytes as f64 / session.seconds() * 60.0;
            assert!(of_minute < bytes_per_minute * 1.05, "{of_minute} of {bytes_per_minute}");
            assert_eq!(session.answers.len(), session.candidates());
            for answer in &session.answers {
                assert_has_what_was_matched(session, answer);
                assert_eq!(answer.map_version, answer.camera as u64);
            }
            let of_camera =
                |camera: usize| session.answers.iter().filter(|answer| answer.camera == camera).count();
            let [ahead, left, behind] = [0, 1, 3].map(of_camera);
            assert_eq!(ahead + left + behind, session.candidates());
            let (most, least) = (ahead.max(left).max(behind), ahead.min(left).min(behind));
            // One that is asked about twice as often may have twice as many where there is room for all.
            assert!(least >= 2 && most <= 2 * least + 1, "{ahead}, {left}, {behind}");
        }
    }
}

/// Also where there are bytes for every second image, and the map is asked about two cameras in turn.
#[test]
fn cameras_take_turns_where_the_budget_is_too_small_for_all() {
    let in_turn = |image: i64| vec![[0, 3][(image / 10 % 2) as usize]];
    for bytes_per_minute in [4e5, 8e5, 1.1e6, 1.2e6, 1.3e6] {
        let folder = tempfile::tempdir().unwrap();
        let settings = surround_settings(folder.path(), bytes_per_minute);
        let sessions = recorded(&settings, drive_with_cameras(2400, in_turn));
        let answers = || sessions.iter().flat_map(|session| &session.answers);
        let [ahead, behind] = [0, 3].map(|camera| answers().filter(|answer| answer.camera == camera).count());
        assert!(ahead.abs_diff(behind) <= 2, "{ahead} and {behind} with {bytes_per_minute} bytes a minute");
        assert!(ahead + behind < 230, "there is room for all");
    }
}

#[test]
fn images_wait_in_bounded_memory() {
    let mut builder = SessionBuilder::new(9e5);
    // A clock that stands still: nothing is ever old enough.
    let chunks: Vec<Chunk> = (0..3000)
        .filter_map(|at| {
            builder.image(at);
            builder.next_chunk()
        })
        .collect();
    assert!(chunks.is_empty());
    let last = builder.end_session().unwrap();
    assert_eq!(last.recorded.images, 3000);
}

#[test]
fn what_a_killed_robot_left_becomes_a_session_and_what_another_one_records_does_not() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let of_robot = settings(path, 9e5, LONG);
    let whole = recorded(&of_robot, drive(400)).remove(0);
    let bytes = std::fs::read(&whole.path).unwrap();
    std::fs::remove_file(&whole.path).unwrap();
    let left = |name: &str, length: usize| {
        let path = path.join(name);
        std::fs::write(&path, &bytes[..length]).unwrap();
        path
    };
    let cut = left("ada_1_1.recording", bytes.len() - 1000);
    let empty = left("ada_1_2.recording", 7);
    let of_other = left("bob_1_1.recording", bytes.len() - 1000);
    let _lock = folder::lock(&of_other).unwrap();
    folder::recover(path, None).unwrap();
    assert!(!cut.exists() && !empty.exists() && of_other.exists());
    let recovered = Session::open(&path.join("ada_1_1.session")).unwrap();
    assert!(!recovered.is_ended && !recovered.frames.is_empty());
    assert_eq!(recovered.whole_bytes, recovered.path.metadata().unwrap().len());
    assert!(!path.join("ada_1_2.session").exists());
}

#[test]
fn a_folder_that_is_full_ends_the_recording_and_is_an_alarm_that_says_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("old.session"), vec![0; 1_000_001]).unwrap();
    let mut output = HandInOutput::start(settings(folder.path(), 9e5, LONG)).unwrap();
    assert_eq!(output.fault(), None);
    for item in drive(400) {
        output.send(item);
    }
    // The thread has ended, whose end of the channel is closed.
    output.sender = None;
    output.thread.take().unwrap().join().unwrap();
    let fault = output.fault().unwrap();
    assert!(fault.contains("1000001 bytes") && fault.contains("driftless hand-in"), "{fault}");
}

/// The sessions of a drive whose clock is set by `by_ns` at an image.
fn recorded_with_clock_set(folder: &Path, at_image: i64, by_ns: i64) -> Vec<Session> {
    let mut output = HandInOutput::start(settings(folder, 9e5, LONG)).unwrap();
    for item in drive(800) {
        if matches!(item, Item::Image(stamp_ns) if stamp_ns == at_image * IMAGE_NS) {
            output.set_clock_shift(by_ns);
        }
        output.send(item);
    }
    drop(output);
    let mut paths: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    paths.iter().map(|path| Session::open(path).unwrap()).collect()
}

#[test]
fn a_session_has_the_times_of_a_clock_that_was_set() {
    const YEARS_NS: i64 = 1_750_000_000_000_000_000;
    let folder = tempfile::tempdir().unwrap();
    // Booted in 1970, and corrected after 15 s.
    let sessions = recorded_with_clock_set(folder.path(), 300, YEARS_NS);
    let [session] = sessions.as_slice() else { panic!("{} sessions", sessions.len()) };
    let recorded = session.recorded.clone().unwrap();
    let (begin_ns, end_ns) = (YEARS_NS + 300 * IMAGE_NS, YEARS_NS + 799 * IMAGE_NS);
    assert_eq!((recorded.begin_ns, recorded.end_ns), (begin_ns, end_ns));
    assert!(
        session.readings.iter().all(|reading| (begin_ns - 200_000_000..end_ns).contains(&reading.stamp_ns))
    );
    assert!(session.frames.iter().all(|frame| (begin_ns..=end_ns).contains(&frame.stamp_ns)));
    assert!(session.answers.len() > 5 && session.answers.iter().all(|answer| answer.stamp_ns >= begin_ns));
    assert_eq!(session.header.started_unix_s, begin_ns as u64 / 1_000_000_000);
    // The identity is that of the readings with these times.
    let mut digest = RecordedDigest::default();
    let readings = (0..8000).map(reading).map(|of| ImuSample { stamp_ns: of.stamp_ns + YEARS_NS, ..of });
    for reading in readings.filter(|reading| (begin_ns..end_ns).contains(&reading.stamp_ns)) {
        let [[a, b, c], [d, e, f]] = [reading.gyroscope, reading.accelerometer].map(<[f64; 3]>::from);
        digest.add_reading(reading.stamp_ns, [a, b, c, d, e, f]);
    }
    (300..800).for_each(|image| digest.add_image(YEARS_NS + image * IMAGE_NS));
    assert_eq!(recorded.id, digest.finish().id.to_bytes());
}

#[test]
fn a_clock_that_is_set_by_little_ends_a_session_and_begins_the_next_whichever_way() {
    for by_ns in [3_600_000_000_000, -2_000_000_000] {
        let folder = tempfile::tempdir().unwrap();
        let sessions = recorded_with_clock_set(folder.path(), 400, by_ns);
        let times: Vec<_> = sessions
            .iter()
            .map(|session| {
                session.recorded.as_ref().map(|recorded| (recorded.begin_ns, recorded.end_ns)).unwrap()
            })
            .collect();
        let after = (by_ns + 400 * IMAGE_NS, by_ns + 799 * IMAGE_NS);
        assert_eq!(times, [(0, 399 * IMAGE_NS), after]);
        let [before, after] = sessions.as_slice() else { panic!("{} sessions", sessions.len()) };
        assert!(before.is_ended && after.candidates() > 5);
        let samples = |session: &Session| session.recorded.clone().unwrap().new_samples;
        assert!(samples(before).iter().all(|sample| !samples(after).contains(sample)));
    }
}
