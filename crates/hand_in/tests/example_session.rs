//! A session for tests: its header, chunks and readings.

use calibration::{CameraSensor, ImuSensor};
use geometry::{Camera, Distortion, Pose};
use hand_in::{Answer, AnsweredMatch, Candidate, Chunk, Header, RecordedSoFar, SessionFrame, SessionWriter};
use nalgebra::{UnitQuaternion, Vector2, Vector3};
use protocol::MapIdentity;
use std::path::Path;
use types::{DescriptorKind, Descriptors, FeatureSet, ImuNoise, ImuSample, TrackObservation};

pub fn header() -> Header {
    let camera = Camera {
        width: 752,
        height: 480,
        focal: [458.0, 457.0],
        centre: [367.0, 248.0],
        distortion: Distortion::None,
    };
    let mut noise = ImuNoise::default();
    (noise.gyroscope, noise.accelerometer) = (1.7e-4, 2e-3);
    Header {
        robot: "ada".to_owned(),
        name: "ada_1".to_owned(),
        program: "test".to_owned(),
        started_unix_s: 1_700_000_000,
        imu: ImuSensor { noise, rate_hz: 200.0, gravity_magnitude: Some(9.81), intrinsics: None },
        cameras: vec![CameraSensor::new(camera, Pose::identity(), 20.0); 2],
    }
}

/// What readings are rounded to: a quarter of the standard deviation of their noise.
pub fn steps() -> [f64; 2] {
    let noise = header().imu.noise;
    [noise.gyroscope, noise.accelerometer].map(|density| density * 200_f64.sqrt() / 4.0)
}

/// A robot with a camera that looks ahead, a stereo pair to the left, and a camera that looks back.
pub fn surround_header() -> Header {
    let sensor = |turned_rad: f64| {
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), turned_rad);
        CameraSensor { imu_from_camera: Pose::new(rotation, Vector3::zeros()), ..header().cameras[0].clone() }
    };
    Header { cameras: [0.0, 1.6, 1.6, 3.1].map(sensor).to_vec(), ..header() }
}

/// The features of an image, which are different for each number.
pub fn features(number: i64) -> FeatureSet {
    FeatureSet {
        pixels: (0..40).map(|point| [point as f32 * 9.37, 100.0 - point as f32]).collect(),
        descriptors: Descriptors {
            kind: DescriptorKind::Int8,
            width: 64,
            bytes: (0..40 * 64).map(|byte| (byte * 31 + number) as u8).collect(),
        },
        extractor: "edgepoint2-1".to_owned(),
    }
}

/// A chunk of a second, which is different for each number.
pub fn chunk(number: i64) -> Chunk {
    let begin_ns = 1_700_000_000_000_000_000 + number * 1_000_000_000;
    let value = |at: i64, axis: i64| ((at * 7 + axis * 3 + number) as f64 * 0.37).sin();
    let vector = |at: i64, axis: i64| Vector3::new(value(at, axis), value(at, axis + 1), value(at, axis + 2));
    let readings = (0..200).map(|at| ImuSample {
        stamp_ns: begin_ns + at * 5_000_000 + at % 3,
        gyroscope: vector(at, 0),
        accelerometer: vector(at, 3) * 9.81,
    });
    let frames = (0..5).map(|at| {
        let tracks = (0..60_u64).flat_map(|point| {
            (0..2).map(move |camera| TrackObservation {
                camera,
                feature_id: 3 * point + at as u64,
                pixel: Vector2::new(point as f64 * 11.3 + at as f64, 20.0 * f64::from(camera) + point as f64),
            })
        });
        let candidate = (at == 2).then(|| Candidate { camera: 0, features: features(number) });
        SessionFrame {
            stamp_ns: begin_ns + at * 200_000_000,
            tracks: tracks.collect(),
            candidates: candidate.into_iter().collect(),
        }
    });
    Chunk {
        recorded: RecordedSoFar {
            id: [number as u8; 16],
            begin_ns: 1_700_000_000_000_000_000,
            end_ns: begin_ns,
            images: 20 * (number as u64 + 1),
            readings: 200 * number as u64,
            new_samples: vec![number as u64, u64::MAX - number as u64],
        },
        readings: readings.collect(),
        frames: frames.collect(),
        answers: vec![Answer {
            stamp_ns: begin_ns + 400_000_000,
            camera: 0,
            map_identity: MapIdentity::from_bytes([7; 16]),
            map_version: 3,
            inliers: 17,
            used: 15,
            accepted: true,
            matches: (0..20)
                .map(|at| AnsweredMatch {
                    feature: at,
                    landmark: 1000 - u64::from(at),
                    keyframe: u64::from(at / 7),
                })
                .collect(),
        }],
    }
}

/// Writes a session of some seconds.
///
/// # Returns
/// Where each of its blocks ends.
pub fn write(path: &Path, seconds: i64) -> Vec<u64> {
    let mut writer = SessionWriter::create(path, &header()).unwrap();
    let mut ends = vec![writer.bytes()];
    for number in 0..seconds {
        writer.append(&chunk(number)).unwrap();
        ends.push(writer.bytes());
    }
    writer.finish().unwrap();
    ends.push(path.metadata().unwrap().len());
    ends
}

/// A block of any content, with its checksum.
pub fn block(kind: u8, payload: &[u8]) -> Vec<u8> {
    let length = (payload.len() as u32).to_le_bytes();
    let mut hasher = crc32fast::Hasher::new();
    for part in [&length[..], &[kind], payload] {
        hasher.update(part);
    }
    [&length[..], &[kind], &hasher.finalize().to_le_bytes(), payload].concat()
}
