//! What is written is read, within the rounding that is stated.

use crate::example_session::{chunk, header, steps, write};
use hand_in::{Chunk, HandInError, Session, SessionWriter};
use nalgebra::{Vector2, Vector3};
use proptest::prelude::*;
use types::{ImuSample, TrackObservation};

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
        let [read, written] = [&read.features, &written.features];
        assert_eq!(read.is_some(), written.is_some());
        for (read, written) in read.iter().zip(written) {
            assert_eq!((&read.descriptors, &read.extractor), (&written.descriptors, &written.extractor));
            for (read, written) in read.pixels.as_flattened().iter().zip(written.pixels.as_flattened()) {
                assert!((read - written).abs() <= 0.5 / 8.0 + 1e-4);
            }
        }
    }
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
            written.frames.push(hand_in::SessionFrame { stamp_ns: begin_ns + at, tracks: tracks.clone(), features: None });
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
}
