//! Readings of the wheels: they come out as they come in, and what is wrong with them is named.

use super::*;

const WHEELS_MS: i64 = 20;

/// Readings of the wheels on time, 2 ms after their stamp.
fn wheels(seconds: i64) -> Script {
    let reading = |k: i64| WheelReading::new(START_NS + k * WHEELS_MS * MS, [k as f64, 1.0]);
    (0..seconds * 1000 / WHEELS_MS)
        .map(|k| (k * WHEELS_MS * MS + 2 * MS, Message::Wheels(reading(k))))
        .collect()
}

fn play_wheels(script: Script, end_s: i64) -> Played {
    let calibration = calibration(1);
    let settings = LiveSettings { wheels: Some(WheelReadings::Speeds), ..LiveSettings::images(&calibration) };
    play_with(LiveBuffer::new(&calibration, &settings), script, end_s, 0)
}

fn beside_others(wheels: Script, seconds: i64) -> Script {
    on_time(1, seconds).into_iter().chain(wheels).collect()
}

#[test]
fn all_of_them_come_out_in_order_where_they_are_expected() {
    let played = play_wheels(beside_others(wheels(5), 5), 5);
    assert_eq!((played.wheels.len(), played.readings.len(), played.frames.len()), (250, 1000, 100));
    assert!(played.wheels.is_sorted_by(|a, b| a.stamp_ns < b.stamp_ns && a.values[0] < b.values[0]));
    assert!(played.named.is_empty(), "{:?}", played.named);
    let unexpected = play(1, beside_others(wheels(5), 5), 5);
    assert!(unexpected.wheels.is_empty() && unexpected.frames.len() == 100);
}

#[test]
fn silent_wheels_are_named_within_two_seconds_and_stop_nothing() {
    let never = play_wheels(on_time(1, 5), 5);
    assert!(never.named_s(Stream::Wheels, FaultKind::Missing).unwrap() <= 2.0);
    assert_eq!(never.frames.len(), 100);
    let mut stopped = wheels(5);
    stopped.retain(|(at, _)| *at < 2 * SECOND);
    let played = play_wheels(beside_others(stopped, 5), 5);
    let named_s = played.named_s(Stream::Wheels, FaultKind::Silent).unwrap();
    assert!((2.0..4.0).contains(&named_s), "{named_s}");
    assert_eq!((played.wheels.len(), played.frames.len()), (100, 100));
}

#[test]
fn a_reading_that_is_not_finite_or_comes_twice_is_left_out_and_named() {
    let mut script = beside_others(wheels(3), 3);
    let wrong = WheelReading::new(START_NS + 1005 * MS, [f64::NAN, 1.0]);
    script.push((1006 * MS, Message::Wheels(wrong)));
    let twice = WheelReading::new(START_NS + 1000 * MS, [50.0, 1.0]);
    script.push((1007 * MS, Message::Wheels(twice)));
    let played = play_wheels(script, 3);
    assert_eq!(played.wheels.len(), 150);
    for kind in [FaultKind::NotFinite, FaultKind::Duplicate] {
        assert!(played.named_s(Stream::Wheels, kind).is_some(), "{:?}", played.named);
    }
}

#[test]
fn a_clock_that_jumps_for_all_is_followed() {
    let jump = |(at, message): (i64, Message)| {
        let by_ns = if at > 3 * SECOND { 100 * SECOND } else { 0 };
        (at, shifted(message, by_ns))
    };
    let script = beside_others(wheels(6), 6).into_iter().map(jump).collect();
    let played = play_wheels(script, 6);
    assert!(played.wheels.windows(2).all(|pair| pair[1].stamp_ns - pair[0].stamp_ns <= 60 * MS));
    assert!(played.wheels.len() > 290, "{}", played.wheels.len());
}
