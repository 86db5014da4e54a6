//! Clocks that jump.

use super::*;

const JUMPS_S: [i64; 6] = [1, -1, 60, -60, 3600, -3600];

/// From 5 s on the clocks of the messages that `jumps` chooses are ahead.
fn jumping(seconds: i64, by_s: i64, jumps: impl Fn(&Message) -> bool) -> Script {
    let at_s = |(at, message): (i64, Message)| {
        let made = at - if is_image(&message) { 20 * MS } else { MS };
        let by_ns = if made >= 5 * SECOND && jumps(&message) { by_s * SECOND } else { 0 };
        (at, shifted(message, by_ns))
    };
    on_time(1, seconds).into_iter().map(at_s).collect()
}

#[test]
fn the_estimators_time_goes_on_where_all_clocks_jump() {
    for by_s in JUMPS_S {
        let played = play(1, jumping(10, by_s, |_| true), 10);
        assert!(played.readings.len() >= 1999, "{by_s} s: {} {:?}", played.readings.len(), played.named);
        assert!(played.frames.len() >= 199, "{by_s} s: {} {:?}", played.frames.len(), played.named);
        for stream in [Stream::Imu, Stream::Camera(0)] {
            let named_s = played.named_s(stream, FaultKind::ClockJump).unwrap();
            assert!((5.0..7.0).contains(&named_s), "{by_s} s: {named_s}");
        }
        // Readings and images are shifted by the same amount, which is the jump up to the jitter of arrivals.
        let shift_ns = played.clock_shift_ns;
        assert!((shift_ns - by_s * SECOND).abs() <= 2 * MS, "{by_s} s: {shift_ns}");
        let aligned = |stamp_ns: &i64, period: i64| {
            let off_ns = (stamp_ns + shift_ns - START_NS).rem_euclid(period * MS);
            off_ns == 0 || *stamp_ns < START_NS + 5 * SECOND
        };
        assert!(played.readings.iter().all(|stamp_ns| aligned(stamp_ns, IMU_MS)));
        assert!(played.frames.iter().all(|stamp_ns| aligned(stamp_ns, CAMERA_MS)));
        let largest = played.readings.windows(2).map(|pair| pair[1] - pair[0]).max().unwrap();
        assert!(largest <= 2 * IMU_MS * MS, "{by_s} s: {largest}");
    }
}

#[test]
fn a_clock_that_jumps_alone_is_followed_and_named() {
    for by_s in JUMPS_S {
        let played = play(1, jumping(10, by_s, |message| !is_image(message)), 10);
        assert!(played.named_s(Stream::Imu, FaultKind::ClockJump).unwrap() < 7.0);
        assert_eq!(played.named_s(Stream::Camera(0), FaultKind::ClockJump), None);
        assert!(played.readings.len() >= 1999 && played.frames.len() >= 199, "{by_s} s: {:?}", played.named);
    }
}

#[test]
fn a_single_wrong_stamp_is_left_out_and_no_jump() {
    for by_s in JUMPS_S {
        let script = on_time(1, 10).into_iter().enumerate().map(|(index, (at, message))| {
            let is_wrong = at >= 5 * SECOND && index % 100 == 0;
            (at, shifted(message, if is_wrong { by_s * SECOND } else { 0 }))
        });
        let played = play(1, script.collect(), 10);
        assert!(played.named_s(Stream::Imu, FaultKind::WrongStamp).unwrap() < 7.0);
        assert_eq!(played.named_s(Stream::Imu, FaultKind::ClockJump), None, "{by_s} s");
        assert!(played.readings.len() > 1980 && played.frames.len() > 190);
    }
}

#[test]
fn messages_that_are_a_second_late_are_no_jump() {
    // The computer stands still for a second, also at the start; then all comes at once.
    for stall_s in [0, 4] {
        let stall = stall_s * SECOND..(stall_s + 1) * SECOND;
        let late = on_time(1, 8)
            .into_iter()
            .map(|(at, message)| (if stall.contains(&at) { stall.end } else { at }, message))
            .collect();
        let played = play(1, late, 8);
        assert_eq!(played.named_s(Stream::Imu, FaultKind::ClockJump), None);
        assert_eq!(played.named_s(Stream::Camera(0), FaultKind::ClockJump), None);
        assert_eq!(played.readings.len(), 1600);
        assert_eq!(played.frames.len() as u64 + played.dropped, 160);
    }
}

#[test]
fn stamps_at_the_ends_of_the_range_break_nothing() {
    let calibration = calibration(2);
    let mut buffer = LiveBuffer::new(&calibration, &LiveSettings::images(&calibration));
    let stamps = [i64::MIN, -1, 0, 4_000_000_000_000_000_000, i64::MAX];
    for (index, stamp_ns) in stamps.into_iter().cycle().take(500).enumerate() {
        let now = Duration::from_millis(10 * index as u64);
        buffer.imu(reading(stamp_ns), now);
        buffer.image(index % 2, stamp_ns, image(stamp_ns), now);
        while buffer.poll(now).is_some() {}
    }
    assert!(buffer.count_of(Stream::Imu, FaultKind::WrongStamp) >= 300);
}
