//! Positions of GNSS: they come out as they come in; a receiver without a position is no fault, a silent one is.

use super::*;
use nalgebra::{Matrix3, Vector3};

/// A position a second, 150 ms after its stamp.
fn positions(seconds: i64) -> Script {
    let position = |k: i64| GnssReading {
        stamp_ns: START_NS + k * SECOND,
        position: Vector3::new(k as f64, 0.0, 0.0),
        covariance: Matrix3::identity(),
    };
    (0..seconds).map(|k| (k * SECOND + 150 * MS, Message::Gnss(position(k)))).collect()
}

fn play_gnss(script: Script, end_s: i64) -> Played {
    let calibration = calibration(1);
    let settings = LiveSettings { gnss: true, ..LiveSettings::images(&calibration) };
    play_with(LiveBuffer::new(&calibration, &settings), script, end_s, 0)
}

#[test]
fn one_a_second_is_no_silence_and_all_come_out() {
    let script = on_time(1, 8).into_iter().chain(positions(8)).collect();
    let played = play_gnss(script, 8);
    let east: Vec<i64> = played.gnss.iter().map(|reading| reading.position.x as i64).collect();
    assert_eq!(east, [0, 1, 2, 3, 4, 5, 6, 7]);
    assert_eq!((played.frames.len(), played.named.len()), (160, 0), "{:?}", played.named);
    let unexpected = play(1, positions(2), 2);
    assert!(unexpected.gnss.is_empty());
}

#[test]
fn a_receiver_without_a_position_is_no_fault_and_a_silent_one_is() {
    let mut script: Script = on_time(1, 16).into_iter().chain(positions(3)).collect();
    script.extend((3..8).map(|k| (k * SECOND, Message::NoFix)));
    let played = play_gnss(script, 16);
    let named_s = played.named_s(Stream::Gnss, FaultKind::Silent).unwrap();
    assert!((12.0..=12.5).contains(&named_s), "{named_s}");
    let bad = GnssReading { stamp_ns: START_NS, position: Vector3::zeros(), covariance: Matrix3::zeros() };
    let played = play_gnss(vec![(MS, Message::Gnss(bad))], 1);
    assert!(played.gnss.is_empty() && played.named_s(Stream::Gnss, FaultKind::NotFinite).is_some());
}
