//! Laws of a live source, on a simulated clock: no test waits.

mod cameras;
mod clocks;
mod gnss;
mod images;
mod imu;
mod threads;
mod wheels;

use super::buffer::{LiveBuffer, Ready};
use super::fault::FaultKind;
use super::image::LiveImage;
use super::settings::LiveSettings;
use super::stream::Stream;
use crate::{
    CameraSensor, GnssReading, ImuNoise, ImuSample, ImuSensor, SensorCalibration, WheelReading, WheelReadings,
};
use geometry::camera::{Camera, Distortion};
use geometry::pose::Pose;
use nalgebra::Vector3;
use std::time::Duration;
use vision::GrayImage;

const MS: i64 = 1_000_000;
const SECOND: i64 = 1_000 * MS;
const START_NS: i64 = 1_403_636_625_938_517_094;
const SIZE: (usize, usize) = (8, 6);
const IMU_MS: i64 = 5;
const CAMERA_MS: i64 = 50;

fn calibration(cameras: usize) -> SensorCalibration {
    let camera = Camera {
        width: SIZE.0 as u32,
        height: SIZE.1 as u32,
        focal: [5.0; 2],
        centre: [4.0, 3.0],
        distortion: Distortion::None,
    };
    let sensor = CameraSensor::new(camera, Pose::identity(), 20.0);
    let imu =
        ImuSensor { noise: ImuNoise::default(), rate_hz: 200.0, gravity_magnitude: None, intrinsics: None };
    SensorCalibration { imu: Some(imu), cameras: vec![sensor; cameras], wheels: None, gnss: None }
}

fn reading(stamp_ns: i64) -> ImuSample {
    ImuSample { stamp_ns, gyroscope: Vector3::zeros(), accelerometer: Vector3::z() * 9.81 }
}

/// An image that differs from those of other times.
fn image(stamp_ns: i64) -> LiveImage {
    LiveImage::Gray(GrayImage::from_fn(SIZE.0, SIZE.1, |x, y| (stamp_ns / MS) as u8 ^ (16 * x + y) as u8))
}

#[derive(Clone, Debug)]
enum Message {
    Imu(ImuSample),
    Image(usize, i64, LiveImage),
    Wheels(WheelReading),
    Gnss(GnssReading),
    /// Of a receiver without a position.
    NoFix,
}

/// Messages with their arrival, nanoseconds since the start.
type Script = Vec<(i64, Message)>;

/// Readings and images of so many cameras on time: readings 1 ms after their stamp, images 20 ms.
fn on_time(cameras: usize, seconds: i64) -> Script {
    let readings = (0..seconds * 1000 / IMU_MS).map(|k| k * IMU_MS * MS);
    let frames = (0..seconds * 1000 / CAMERA_MS).map(|k| k * CAMERA_MS * MS);
    let readings = readings.map(|at| (at + MS, Message::Imu(reading(START_NS + at))));
    let images = frames.flat_map(move |at| {
        (0..cameras)
            .map(move |camera| (at + 20 * MS, Message::Image(camera, START_NS + at, image(START_NS + at))))
    });
    let mut script: Script = readings.chain(images).collect();
    script.sort_by_key(|(at, _)| *at);
    script
}

fn is_image(message: &Message) -> bool {
    matches!(message, Message::Image(..))
}

/// Shifts stamps.
fn shifted(message: Message, by_ns: i64) -> Message {
    match message {
        Message::Imu(reading) => Message::Imu(ImuSample { stamp_ns: reading.stamp_ns + by_ns, ..reading }),
        Message::Image(camera, stamp_ns, image) => Message::Image(camera, stamp_ns + by_ns, image),
        Message::Wheels(reading) => {
            Message::Wheels(WheelReading { stamp_ns: reading.stamp_ns + by_ns, ..reading })
        }
        Message::Gnss(reading) => {
            Message::Gnss(GnssReading { stamp_ns: reading.stamp_ns + by_ns, ..reading })
        }
        Message::NoFix => message,
    }
}

/// What came out.
#[derive(Debug, Default)]
struct Played {
    readings: Vec<i64>,
    wheels: Vec<WheelReading>,
    gnss: Vec<GnssReading>,
    frames: Vec<i64>,
    /// Frames with both images.
    pairs: usize,
    /// From the arrival of a frame's image to its return, milliseconds.
    delays_ms: Vec<i64>,
    /// When each fault was active first, milliseconds.
    named: Vec<(Stream, FaultKind, i64, String)>,
    active_at_end: Vec<(Stream, FaultKind)>,
    dropped: u64,
    clock_shift_ns: i64,
}

impl Played {
    /// When a fault was named first, seconds.
    fn named_s(&self, stream: Stream, kind: FaultKind) -> Option<f64> {
        let is_it = |entry: &&(Stream, FaultKind, i64, String)| (entry.0, entry.1) == (stream, kind);
        self.named.iter().find(is_it).map(|entry| entry.2 as f64 * 1e-3)
    }

    /// Panics unless events are in order: once a frame was returned, all readings up to it were.
    fn assert_order(&self) {
        assert!(self.readings.is_sorted_by(|a, b| a < b));
        assert!(self.frames.is_sorted_by(|a, b| a < b));
    }
}

/// Plays a script in steps of a millisecond until `end_s`, with a reader that is busy for `busy_ms` after each frame.
fn play_with(mut buffer: LiveBuffer, mut script: Script, end_s: i64, busy_ms: i64) -> Played {
    script.sort_by_key(|(at, _)| *at);
    let arrivals: Vec<(i64, i64)> = script
        .iter()
        .filter_map(|(at, message)| match message {
            Message::Image(0, stamp_ns, _) => Some((*stamp_ns, *at)),
            _ => None,
        })
        .collect();
    let mut played = Played::default();
    let mut script = script.into_iter().peekable();
    let mut free_ms = 0;
    for ms in 0..end_s * 1000 {
        let now = Duration::from_millis(ms as u64);
        while let Some((_, message)) = script.next_if(|(at, _)| *at <= ms * MS) {
            match message {
                Message::Imu(reading) => buffer.imu(reading, now),
                Message::Wheels(reading) => buffer.wheels(reading, now),
                Message::Gnss(reading) => buffer.gnss(reading, now),
                Message::NoFix => drop(buffer.arrived(Stream::Gnss, now)),
                Message::Image(camera, stamp_ns, image) => buffer.image(camera, stamp_ns, image, now),
            }
        }
        while ms >= free_ms {
            match buffer.poll(now) {
                Some(Ready::Imu(reading)) => {
                    assert!(played.frames.last().is_none_or(|frame_ns| reading.stamp_ns > *frame_ns));
                    played.readings.push(reading.stamp_ns);
                }
                Some(Ready::Wheels(reading)) => played.wheels.push(reading),
                Some(Ready::Gnss(reading)) => played.gnss.push(reading),
                Some(Ready::Frame(stamp_ns, frame)) => {
                    played.frames.push(stamp_ns);
                    played.pairs += usize::from(frame.images.len() == 2);
                    let arrival = arrivals.iter().find(|(of, _)| *of == stamp_ns);
                    played.delays_ms.extend(arrival.map(|(_, at)| ms - at / MS));
                    free_ms = ms + busy_ms;
                }
                None => break,
            }
        }
        for fault in buffer.active_faults(now) {
            if played.named_s(fault.stream, fault.kind).is_none() {
                played.named.push((fault.stream, fault.kind, ms, fault.to_string()));
            }
        }
    }
    let end = Duration::from_secs(end_s as u64);
    played.active_at_end = buffer.active_faults(end).iter().map(|fault| (fault.stream, fault.kind)).collect();
    played.dropped = buffer.count(FaultKind::Overload) + buffer.count(FaultKind::WithoutImu);
    played.clock_shift_ns = buffer.clock_shift_ns();
    played.assert_order();
    played
}

fn play(cameras: usize, script: Script, end_s: i64) -> Played {
    let calibration = calibration(cameras);
    play_with(LiveBuffer::new(&calibration, &LiveSettings::images(&calibration)), script, end_s, 0)
}
