//! Images: pairs, silence, frozen cameras, a reader that is too slow.

use super::*;
use geometry::Rotation;
use std::ops::Range;

#[test]
fn pairs_are_joined_within_the_tolerance_and_have_the_stamp_of_the_first() {
    for (offset_us, pairs) in [(0, 100), (2000, 100), (-4900, 100), (9000, 0)] {
        let apart = on_time(2, 5).into_iter().map(|(at, message)| match message {
            Message::Image(1, stamp_ns, image) => (at, Message::Image(1, stamp_ns + offset_us * 1000, image)),
            message => (at, message),
        });
        let played = play(2, apart.collect(), 6);
        assert_eq!((played.pairs, played.frames.len()), (pairs, 100), "{offset_us} us");
        assert!(played.frames.iter().all(|stamp_ns| (stamp_ns - START_NS) % (CAMERA_MS * MS) == 0));
        let named_s = played.named_s(Stream::Camera(0), FaultKind::Unpaired);
        assert_eq!(named_s.is_none(), pairs > 0);
        assert!(named_s.is_none_or(|named_s| named_s < 2.0));
    }
}

#[test]
fn stamps_that_are_late_by_a_calibrated_shift_are_put_right_before_images_are_joined() {
    let mut calibration = calibration(2);
    calibration.cameras[1].time_shift_s = -0.02;
    let late = on_time(2, 5).into_iter().map(|(at, message)| match message {
        Message::Image(1, stamp_ns, image) => (at, Message::Image(1, stamp_ns + 20 * MS, image)),
        message => (at, message),
    });
    let buffer = LiveBuffer::new(&calibration, &LiveSettings::images(&calibration));
    let played = play_with(buffer, late.collect(), 6, 0);
    assert_eq!((played.pairs, played.frames.len()), (100, 100));
    assert!(played.frames.iter().all(|stamp_ns| (stamp_ns - START_NS) % (CAMERA_MS * MS) == 0));
}

/// Two cameras on time, one of which gives no image for a while.
fn interrupted(seconds: i64, camera: usize, gone: &Range<i64>) -> Script {
    let is_lost = |(at, message): &(i64, Message)| {
        matches!(message, Message::Image(of, ..) if *of == camera) && gone.contains(at)
    };
    on_time(2, seconds).into_iter().filter(|message| !is_lost(message)).collect()
}

#[test]
fn a_second_camera_that_stops_leaves_the_first_and_comes_back() {
    let gone = 3 * SECOND..7 * SECOND;
    let script = interrupted(10, 1, &gone);
    let played = play(2, script, 10);
    // Its first image finds its partner used already.
    assert_eq!((played.frames.len(), played.pairs), (200, 119));
    assert!(played.named_s(Stream::Camera(1), FaultKind::Silent).unwrap() < 5.0);
    // Once it is known to be silent, nobody waits for it.
    let while_silent = &played.delays_ms[90..130];
    assert!(while_silent.iter().all(|delay| *delay == 0), "{while_silent:?}");
}

#[test]
fn a_first_camera_that_stops_is_named_and_its_partner_is_not_used_alone() {
    let gone = 3 * SECOND..6 * SECOND;
    let script = interrupted(8, 0, &gone);
    let played = play(2, script, 8);
    assert_eq!((played.frames.len(), played.pairs), (100, 100));
    assert!(played.named_s(Stream::Camera(0), FaultKind::Silent).unwrap() < 5.0);
    assert!(played.named_s(Stream::Camera(1), FaultKind::Unpaired).unwrap() < 5.0);
    assert_eq!(played.readings.len(), 1600);
}

/// Two cameras, of which the second looks back.
fn play_rig(script: Script, end_s: i64) -> Played {
    let mut calibration = calibration(2);
    let back = Rotation::from_axis_angle(&Vector3::y_axis(), std::f64::consts::PI);
    calibration.cameras[1].imu_from_camera = Pose::new(back, Vector3::zeros());
    play_with(LiveBuffer::new(&calibration, &LiveSettings::images(&calibration)), script, end_s, 0)
}

#[test]
fn cameras_that_see_different_things_and_are_triggered_apart_give_frames_of_their_own() {
    let apart = on_time(2, 5).into_iter().map(|(at, message)| match message {
        Message::Image(1, ..) => (at + 25 * MS, shifted(message, 25 * MS)),
        message => (at, message),
    });
    let played = play_rig(apart.collect(), 6);
    // The first image waits for what may be late; none of those that come meanwhile is dropped.
    let missing: Vec<i64> = (0..200).filter(|k| !played.frames.contains(&(START_NS + k * 25 * MS))).collect();
    assert!(missing.is_empty(), "{missing:?}");
    assert_eq!(played.named_s(Stream::Camera(0), FaultKind::Overload), None);
    assert_eq!(played.pairs, 0);
    assert_eq!(played.named_s(Stream::Camera(0), FaultKind::Unpaired), None);
    // Each waits at most for the next image, which shows that there is none of the other camera.
    assert!(played.delays_ms[10..].iter().all(|delay| *delay <= 25), "{:?}", played.delays_ms);
}

#[test]
fn a_first_camera_that_stops_leaves_one_that_sees_something_else() {
    let gone = 3 * SECOND..6 * SECOND;
    let script = interrupted(8, 0, &gone);
    let played = play_rig(script, 9);
    assert_eq!((played.frames.len(), played.pairs), (160, 100));
    assert!(played.named_s(Stream::Camera(0), FaultKind::Silent).unwrap() < 5.0);
    assert_eq!(played.named_s(Stream::Camera(1), FaultKind::Unpaired), None);
}

#[test]
fn a_stream_that_never_comes_is_named() {
    let only_images = on_time(1, 4).into_iter().filter(|(_, message)| is_image(message)).collect();
    let played = play(1, only_images, 4);
    assert!(played.named_s(Stream::Imu, FaultKind::Missing).unwrap() < 2.0);
    assert!(played.frames.is_empty() && played.dropped > 0);
    let only_readings = on_time(1, 4).into_iter().filter(|(_, message)| !is_image(message)).collect();
    let played = play(1, only_readings, 4);
    assert!(played.named_s(Stream::Camera(0), FaultKind::Missing).unwrap() < 2.0);
    assert_eq!(played.readings.len(), 800);
}

#[test]
fn a_frozen_camera_is_named_and_its_image_is_not_used_again() {
    let frozen = 3 * SECOND..6 * SECOND;
    let script = on_time(1, 8).into_iter().map(|(at, message)| match message {
        Message::Image(0, stamp_ns, _) if frozen.contains(&at) => {
            (at, Message::Image(0, stamp_ns, image(START_NS + 2_950 * MS)))
        }
        message => (at, message),
    });
    let played = play(1, script.collect(), 8);
    let named_s = played.named_s(Stream::Camera(0), FaultKind::Frozen).unwrap();
    assert!((3.9..5.0).contains(&named_s), "{named_s}");
    assert_eq!(played.frames.len(), 160 - 60);
}

#[test]
fn a_slow_reader_gets_all_readings_and_new_images_evenly() {
    let end_s = 20;
    let calibration = calibration(1);
    let buffer = LiveBuffer::new(&calibration, &LiveSettings::images(&calibration));
    // A quarter of the speed that is needed.
    let played = play_with(buffer, on_time(1, end_s), end_s, 4 * CAMERA_MS);
    assert!(played.named_s(Stream::Camera(0), FaultKind::Overload).unwrap() < 2.0);
    let missing = end_s * 200 - played.readings.len() as i64;
    assert!(missing < 100, "{missing} readings are still to come");
    assert!((95..=101).contains(&played.frames.len()), "{}", played.frames.len());
    let steady = &played.frames[10..];
    let largest = steady.windows(2).map(|pair| pair[1] - pair[0]).max().unwrap();
    assert!(largest <= 6 * CAMERA_MS * MS, "{largest}");
    assert!(played.delays_ms[10..].iter().all(|delay| *delay <= 6 * CAMERA_MS), "{:?}", played.delays_ms);
}

#[test]
fn memory_is_bounded_where_nobody_reads() {
    let calibration = calibration(1);
    let mut buffer = LiveBuffer::new(&calibration, &LiveSettings::images(&calibration));
    for (at, message) in on_time(1, 60) {
        let now = Duration::from_nanos(at as u64);
        match message {
            Message::Imu(reading) => buffer.imu(reading, now),
            Message::Image(camera, stamp_ns, image) => buffer.image(camera, stamp_ns, image, now),
            Message::Wheels(_) | Message::Gnss(_) | Message::NoFix => unreachable!("there are none"),
        }
    }
    let end = Duration::from_mins(1);
    let ready: Vec<Ready> = std::iter::from_fn(|| buffer.poll(end)).collect();
    let frames = ready.iter().filter(|ready| matches!(ready, Ready::Frame(..))).count();
    assert_eq!((frames, ready.len() - frames), (5, 12_000));
    assert_eq!(buffer.count_of(Stream::Camera(0), FaultKind::Overload), 1195);
}
