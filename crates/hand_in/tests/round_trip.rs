//! What is written is read, within the rounding that is stated.

use crate::example_session::{chunk, features, header, steps, surround_header, write};
use hand_in::{Answer, Candidate, Chunk, HandInError, Header, Session, SessionFrame, SessionWriter};
use nalgebra::{Vector2, Vector3};
use proptest::prelude::*;
use std::collections::BTreeMap;
use std::path::Path;
use types::{DescriptorKind, Descriptors, FeatureSet, ImuSample, TrackObservation};

#[test]
fn a_session_is_read_as_it_was_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.session");
    write(&path, 3);
    let session = Session::open(&path).unwrap();
    assert!(session.is_ended);
    assert_eq!(session.whole_bytes, path.metadata().unwrap().len());
    assert_eq!(session.header, header());
    let chunks: Vec<Chunk> = (0..3).map(chunk).collect();
    let all_samples: Vec<u64> = chunks.iter().flat_map(|chunk| chunk.recorded.new_samples.clone()).collect();
    let recorded = session.recorded.unwrap();
    assert_eq!((recorded.id, recorded.new_samples), ([2; 16], all_samples));
    assert_eq!(session.answers, chunks.iter().flat_map(|chunk| chunk.answers.clone()).collect::<Vec<_>>());
    let written = chunks.iter().flat_map(|chunk| &chunk.frames);
    for (read, written) in session.frames.iter().zip(written) {
        assert_eq!((read.stamp_ns, read.tracks.len()), (written.stamp_ns, written.tracks.len()));
        for (read, written) in read.tracks.iter().zip(&written.tracks) {
            assert_eq!((read.camera, read.feature_id), (written.camera, written.feature_id));
            assert!((read.pixel - written.pixel).amax() <= 0.5 / 16.0, "{read:?} of {written:?}");
        }
        assert_same_candidates(&read.candidates, &written.candidates);
    }
}

/// Candidates that differ by the rounding of their pixels only.
fn assert_same_candidates(read: &[Candidate], written: &[Candidate]) {
    assert_eq!(read.len(), written.len());
    for (read, written) in read.iter().zip(written) {
        assert_eq!(read.camera, written.camera);
        let [read, written] = [&read.features, &written.features];
        assert_eq!((&read.descriptors, &read.extractor), (&written.descriptors, &written.extractor));
        assert_eq!(read.pixels.len(), written.pixels.len());
        for (read, written) in read.pixels.as_flattened().iter().zip(written.pixels.as_flattened()) {
            assert!((read - written).abs() <= 0.5 / 8.0 + 1e-4);
        }
    }
}

/// The version of the format of a file.
fn schema(path: &Path) -> u8 {
    std::fs::read(path).unwrap()[8]
}

/// Programs that know the first version only read what robots with one stereo pair or single camera record.
#[test]
fn only_files_of_robots_that_ask_about_several_cameras_have_the_second_version() {
    let folder = tempfile::tempdir().unwrap();
    let schema_of = |name: &str, header: Header| {
        let path = folder.path().join(name);
        SessionWriter::create(&path, &header).unwrap();
        schema(&path)
    };
    let cameras = |kept: &[usize]| {
        let all = surround_header();
        Header { cameras: kept.iter().map(|&at| all.cameras[at].clone()).collect(), ..all }
    };
    assert_eq!(schema_of("single", cameras(&[0])), 1);
    assert_eq!(schema_of("pair", cameras(&[1, 2])), 1);
    assert_eq!(schema_of("two", cameras(&[0, 3])), 2);
    assert_eq!(schema_of("surround", surround_header()), 2);
}

/// A file as it was written before candidates stated their camera.
#[test]
fn a_file_of_the_first_version_is_read_as_one_of_camera_0_also_from_several_cameras() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.session");
    let ends = write(&path, 2);
    let of_pair = std::fs::read(&path).unwrap();
    // The same chunks behind the header of a robot with more cameras, by a program that knew the first version only.
    let surround = folder.path().join("b.session");
    SessionWriter::create(&surround, &surround_header()).unwrap();
    let mut bytes = std::fs::read(&surround).unwrap();
    bytes[8] = 1;
    bytes.extend(&of_pair[ends[0] as usize..]);
    let session = Session::of_bytes(&path, &bytes).unwrap();
    assert_eq!(session.header.cameras.len(), 4);
    let whole = Session::of_bytes(&path, &of_pair).unwrap();
    assert_eq!(session.candidates(), 2);
    assert_eq!((session.frames, session.answers), (whole.frames, whole.answers));
}

#[test]
fn a_robot_with_one_pair_writes_what_is_of_camera_0() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.session");
    let mut written = chunk(0);
    written.frames[2].candidates.push(Candidate { camera: 1, features: features(1) });
    written.answers.push(Answer { camera: 1, ..written.answers[0].clone() });
    SessionWriter::create(&path, &header()).unwrap().append(&written).unwrap();
    let session = Session::open(&path).unwrap();
    assert_eq!((session.candidates(), session.answers.len()), (1, 1));
    assert_eq!(session.answers, chunk(0).answers);
}

/// Features of some number.
fn some_features(count: usize, number: u8) -> FeatureSet {
    let pixels = (0..count).map(|at| [at as f32 * 3.3 + f32::from(number), 7.0 - at as f32]);
    let bytes = (0..count * 8).map(|at| at as u8 ^ number).collect();
    let descriptors = Descriptors { kind: DescriptorKind::Binary, width: 8, bytes };
    FeatureSet { pixels: pixels.collect(), descriptors, extractor: "test-1".to_owned() }
}

#[test]
fn rounding_of_readings_adds_less_than_a_hundredth_to_the_variance_of_their_noise() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.session");
    write(&path, 20);
    let session = Session::open(&path).unwrap();
    let written: Vec<ImuSample> = (0..20).flat_map(|number| chunk(number).readings).collect();
    assert_eq!(session.readings.len(), written.len());
    let sums = session.readings.iter().zip(&written).fold([0.0; 2], |[rates, forces], (read, written)| {
        assert_eq!(read.stamp_ns, written.stamp_ns);
        let of_rates = (read.gyroscope - written.gyroscope).norm_squared();
        let of_forces = (read.accelerometer - written.accelerometer).norm_squared();
        [rates + of_rates, forces + of_forces]
    });
    for (sum, step) in sums.into_iter().zip(steps()) {
        let (rounding, noise) = (sum / (3 * written.len()) as f64, (4.0 * step).powi(2));
        assert!(rounding > 0.0 && rounding < 0.01 * noise, "{rounding} of {noise}");
    }
}

#[test]
fn a_file_that_exists_is_not_written_again() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.session");
    write(&path, 1);
    let before = std::fs::read(&path).unwrap();
    assert!(matches!(SessionWriter::create(&path, &header()), Err(HandInError::Io { .. })));
    assert_eq!(std::fs::read(&path).unwrap(), before);
}

fn any_reading() -> impl Strategy<Value = (i64, [f64; 6])> {
    (1..20_000_000_i64, prop::array::uniform6(-2000.0..2000.0_f64))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn any_readings_and_points_come_back(
        begin_ns in -(1_i64 << 60)..(1 << 60),
        readings in prop::collection::vec(any_reading(), 0..40),
        points in prop::collection::vec((any::<u64>(), 0..2_u8, -2e5..2e5_f64, -2e5..2e5_f64), 0..40),
    ) {
        let mut stamp_ns = begin_ns;
        let readings: Vec<ImuSample> = readings.into_iter().map(|(step, [a, b, c, d, e, f])| {
            stamp_ns += step;
            ImuSample { stamp_ns, gyroscope: Vector3::new(a, b, c), accelerometer: Vector3::new(d, e, f) }
        }).collect();
        let mut tracks: Vec<TrackObservation> = points.into_iter().map(|(feature_id, camera, u, v)| {
            TrackObservation { camera, feature_id, pixel: Vector2::new(u, v) }
        }).collect();
        tracks.sort_by_key(|track| (track.feature_id, track.camera));
        tracks.dedup_by_key(|track| (track.feature_id, track.camera));
        let mut written = Chunk { readings, ..Chunk::default() };
        for at in 0..2 {
            written.frames.push(SessionFrame {
                stamp_ns: begin_ns + at,
                tracks: tracks.clone(),
                candidates: Vec::new(),
            });
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.session");
        SessionWriter::create(&path, &header()).unwrap().append(&written).unwrap();
        let session = Session::open(&path).unwrap();
        prop_assert_eq!(session.readings.len(), written.readings.len());
        for (read, written) in session.readings.iter().zip(&written.readings) {
            prop_assert_eq!(read.stamp_ns, written.stamp_ns);
            prop_assert!((read.gyroscope - written.gyroscope).amax() <= steps()[0] * 0.5001);
            prop_assert!((read.accelerometer - written.accelerometer).amax() <= steps()[1] * 0.5001);
        }
        for frame in &session.frames {
            prop_assert_eq!(frame.tracks.len(), tracks.len());
            for (read, written) in frame.tracks.iter().zip(&tracks) {
                prop_assert_eq!((read.feature_id, read.camera), (written.feature_id, written.camera));
                prop_assert!((read.pixel - written.pixel).amax() <= 0.5 / 16.0 + 1e-9);
            }
        }
    }

    #[test]
    fn candidates_and_answers_of_any_cameras_come_back(
        begin_ns in -(1_i64 << 60)..(1 << 60),
        frames in prop::collection::vec(
            (1..2_000_000_000_i64, prop::collection::btree_map(0..4_usize, (0..20_usize, any::<u8>(), any::<bool>()), 0..4)),
            0..20,
        ),
    ) {
        let mut written = Chunk::default();
        let mut stamp_ns = begin_ns;
        for (step_ns, images) in frames {
            stamp_ns += step_ns;
            let images: BTreeMap<usize, (usize, u8, bool)> = images;
            let candidate = |(&camera, &(count, number, _)): (&usize, &(usize, u8, bool))| {
                Candidate { camera, features: some_features(count, number) }
            };
            let answer = |(&camera, &(_, number, _)): (&usize, &(usize, u8, bool))| {
                Answer { stamp_ns, camera, map_version: u64::from(number), ..chunk(0).answers[0].clone() }
            };
            let candidates = images.iter().map(candidate).collect();
            written.frames.push(SessionFrame { stamp_ns, tracks: Vec::new(), candidates });
            written.answers.extend(images.iter().filter(|(_, (_, _, is_answered))| *is_answered).map(answer));
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.session");
        SessionWriter::create(&path, &surround_header()).unwrap().append(&written).unwrap();
        let session = Session::open(&path).unwrap();
        prop_assert_eq!(session.answers, written.answers);
        prop_assert_eq!(session.frames.len(), written.frames.len());
        for (read, written) in session.frames.iter().zip(&written.frames) {
            prop_assert_eq!(read.stamp_ns, written.stamp_ns);
            assert_same_candidates(&read.candidates, &written.candidates);
        }
    }
}
