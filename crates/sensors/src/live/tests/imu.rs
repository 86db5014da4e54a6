//! Readings: none is lost.

use super::*;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

#[test]
fn what_is_on_time_is_returned_at_once_and_nothing_is_said() {
    for cameras in [1, 2] {
        let played = play(cameras, on_time(cameras, 5), 5);
        assert_eq!((played.readings.len(), played.frames.len()), (1000, 100));
        assert_eq!(played.pairs, if cameras == 2 { 100 } else { 0 });
        // The first messages wait for what may be before them.
        assert!(played.delays_ms[5..].iter().all(|delay| *delay == 0), "{:?}", played.delays_ms);
        assert!(played.named.is_empty(), "{:?}", played.named);
    }
}

#[test]
fn readings_and_images_up_to_200_ms_late_are_sorted_in() {
    for seed in 0..5 {
        let mut rng = StdRng::seed_from_u64(seed);
        let late = on_time(1, 10)
            .into_iter()
            .map(|(at, message)| (at + rng.random_range(0..170) * MS, message))
            .collect();
        let played = play(1, late, 11);
        assert_eq!((played.readings.len(), played.frames.len()), (2000, 200), "{:?}", played.named);
    }
}

#[test]
fn bursts_lose_no_reading() {
    let burst =
        on_time(1, 8).into_iter().map(|(at, message)| ((at / (250 * MS) + 1) * 250 * MS, message)).collect();
    let played = play(1, burst, 9);
    assert_eq!(played.readings.len(), 1600, "{:?}", played.named);
    assert!(played.frames.len() + played.dropped as usize == 160);
}

#[test]
fn messages_that_come_twice_are_used_once_and_named() {
    let twice: Script = on_time(2, 5)
        .into_iter()
        .flat_map(|(at, message)| [(at, message.clone()), (at + 30 * MS, message)])
        .collect();
    let played = play(2, twice, 6);
    assert_eq!((played.readings.len(), played.pairs), (1000, 100));
    for stream in [Stream::Imu, Stream::Camera(0), Stream::Camera(1)] {
        assert!(played.named_s(stream, FaultKind::Duplicate).unwrap() < 2.0);
    }
}

#[test]
fn readings_that_are_not_finite_are_left_out_and_named() {
    let spoilt = |(at, message): (i64, Message)| match message {
        Message::Imu(mut reading) if (3 * SECOND..3 * SECOND + 100 * MS).contains(&at) => {
            reading.gyroscope.y = f64::NAN;
            (at, Message::Imu(reading))
        }
        message => (at, message),
    };
    let played = play(1, on_time(1, 12).into_iter().map(spoilt).collect(), 12);
    let lost = 2400 - played.readings.len();
    assert_eq!(lost, 20);
    let named_s = played.named_s(Stream::Imu, FaultKind::NotFinite).unwrap();
    assert!((3.0..5.0).contains(&named_s), "{named_s}");
    assert!(played.active_at_end.is_empty(), "{:?}", played.active_at_end);
    assert_eq!(played.frames.len() as u64 + played.dropped, 240);
}

#[test]
fn a_pause_of_a_second_and_a_restarted_driver_are_named_and_taken_up_again() {
    for pause_ms in [1_500, 20_000] {
        let silent = 3 * SECOND..3 * SECOND + pause_ms * MS;
        let end_s = 30;
        let script = on_time(1, end_s);
        let heard = script.into_iter().filter(|(at, message)| is_image(message) || !silent.contains(at));
        let played = play(1, heard.collect(), end_s);
        let named_s = played.named_s(Stream::Imu, FaultKind::Silent).unwrap();
        assert!((3.9..5.0).contains(&named_s), "{named_s}");
        assert_eq!(played.readings.len() as i64, end_s * 200 - pause_ms / IMU_MS);
        // Images without readings wait, and the oldest of them are dropped.
        assert_eq!(played.frames.len() as u64 + played.dropped, 600);
        assert_eq!(*played.frames.last().unwrap(), START_NS + 30 * SECOND - CAMERA_MS * MS);
        assert!(!played.active_at_end.iter().any(|(stream, _)| *stream == Stream::Imu));
        assert_eq!(played.named_s(Stream::Imu, FaultKind::ClockJump), None);
    }
}

#[test]
fn a_packet_lost_now_and_then_does_not_hold_images_up() {
    let mut rng = StdRng::seed_from_u64(1);
    let lossy: Script = on_time(1, 20)
        .into_iter()
        .filter(|(_, message)| is_image(message) || rng.random_bool(0.98))
        .collect();
    let played = play(1, lossy, 20);
    assert!(played.frames.len() >= 399);
    let mut delays = played.delays_ms[100..].to_vec();
    delays.sort_unstable();
    assert!(delays[delays.len() * 9 / 10] <= 10, "{delays:?}");
}

#[test]
fn another_rate_than_the_stated_one_is_named() {
    let half: Script = on_time(1, 5)
        .into_iter()
        .filter(|(_, message)| match message {
            Message::Imu(reading) => (reading.stamp_ns - START_NS) % (2 * IMU_MS * MS) == 0,
            Message::Image(_, stamp_ns, _) => (stamp_ns - START_NS) % (2 * CAMERA_MS * MS) == 0,
            Message::Wheels(_) | Message::Gnss(_) | Message::NoFix => true,
        })
        .collect();
    let played = play(1, half, 6);
    for (stream, text) in [(Stream::Imu, "100.0"), (Stream::Camera(0), "10.0")] {
        assert!(played.named_s(stream, FaultKind::WrongRate).unwrap() < 2.0);
        assert!(played.named.iter().any(|entry| entry.0 == stream && entry.3.contains(text)));
    }
    assert_eq!((played.readings.len(), played.frames.len()), (500, 50));
}
