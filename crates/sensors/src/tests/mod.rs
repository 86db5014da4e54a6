//! Laws of recordings and of the sources that play them.

mod bad_input;
mod disorder;
mod four_seasons;
mod gravity;
mod kalibr;
mod other_programs;
mod plausibility;
mod round_trip;
mod source;
mod stamps;
mod wheels;

use super::*;
use geometry::camera::{Camera, Distortion};
use geometry::pose::Pose;
use nalgebra::{UnitQuaternion, Vector2, Vector3};
use protocol::{DescriptorKind, Descriptors, FeatureSet};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

const START_NS: i64 = 1_403_636_625_938_517_094;

fn vector(rng: &mut StdRng, scale: f64) -> Vector3<f64> {
    Vector3::from_fn(|_, _| rng.random_range(-scale..scale))
}

fn pose(rng: &mut StdRng) -> Pose {
    Pose::new(UnitQuaternion::from_scaled_axis(vector(rng, 1.5)), vector(rng, 100.0))
}

/// Of the rolling shutters: a time from row to row that decimal fractions state exactly.
const READOUT_S: f64 = 480.0 / 32_768.0;

fn camera(rng: &mut StdRng, distortion: Distortion) -> CameraSensor {
    let camera =
        Camera { width: 752, height: 480, focal: [458.654, 457.296], centre: [367.215, 248.375], distortion };
    CameraSensor { readout_s: READOUT_S, ..CameraSensor::new(camera, pose(rng), 10.0) }
}

/// A small recording with everything in it, and with the gaps that real ones have.
fn sequence(seed: u64) -> Sequence {
    let mut rng = StdRng::seed_from_u64(seed);
    let distortions = [
        Distortion::None,
        Distortion::RadialTangential([-0.28, 0.07, 1.9e-4, 1.8e-5]),
        Distortion::Equidistant([0.01, -0.02, 0.003, -4e-4]),
        Distortion::Fov(0.93),
        Distortion::Rational([
            -0.21, 0.05, 1e-3, -7e-4, -0.004, 0.02, 0.01, 0.003, 1.2e-3, -4e-4, 8e-4, 3e-6,
        ]),
        Distortion::ThinPrismFisheye([-0.04, 0.01, 2e-4, -4e-4, -0.004, 8e-4, 6e-4, -9e-6]),
        Distortion::DoubleSphere { xi: -0.2, alpha: 0.57 },
        Distortion::Eucm { alpha: 0.63, beta: 1.04 },
        Distortion::Omni { xi: 1.85, distortion: [-0.07, 0.4, -1.2e-3, 8e-4] },
    ];
    let stereo = seed.is_multiple_of(2);
    let cameras = (0..if stereo { 2 } else { 1 })
        .map(|_| distortions[rng.random_range(0..distortions.len())])
        .collect::<Vec<_>>();
    let cameras = cameras.into_iter().map(|distortion| camera(&mut rng, distortion)).collect::<Vec<_>>();
    let frames = (0..8).map(|index| frame(&mut rng, index, cameras.len() as u8)).collect();
    let groundtruth = (0..10).map(|index| truth_row(&mut rng, index)).collect();
    let reference = (0..5)
        .map(|index| ReferencePose::isotropic(START_NS + index * 1_000_000_000, pose(&mut rng), 0.0158, 0.1));
    Sequence {
        root: PathBuf::new(),
        reference_poses: Some(reference.collect()),
        imu: Some(ImuSensor {
            noise: ImuNoise::default(),
            rate_hz: 200.0,
            gravity_magnitude: stereo.then_some(9.808_084),
            intrinsics: None,
        }),
        imu_samples: (0..50)
            .map(|index| ImuSample {
                stamp_ns: START_NS + index * 4_999_777,
                gyroscope: vector(&mut rng, 1.0),
                accelerometer: vector(&mut rng, 12.0),
            })
            .collect(),
        wheels: stereo.then(|| WheelSensor {
            sigma_speed_rad_s: Some(0.03),
            ..WheelSensor::new(WheelBase::new(BaseKind::Differential, 0.1, 0.5), pose(&mut rng))
        }),
        gnss: stereo.then(|| GnssSensor {
            antenna_in_imu: vector(&mut rng, 1.0),
            correlation_time_s: Some(12.0),
            ..GnssSensor::default()
        }),
        gnss_readings: (0..5)
            .map(|index| GnssReading {
                stamp_ns: START_NS + index * 100_777_000,
                position: vector(&mut rng, 50.0),
                covariance: nalgebra::Matrix3::from_diagonal(&Vector3::new(0.25, 1.0, 2.25)),
            })
            .collect(),
        wheel_readings: (0..20)
            .map(|index| {
                let speeds = [rng.random_range(-20.0..20.0), rng.random_range(-20.0..20.0)];
                WheelReading::new(START_NS + index * 19_999_777, speeds)
            })
            .collect(),
        cameras,
        frames,
        groundtruth: Some(groundtruth),
    }
}

fn frame(rng: &mut StdRng, index: i64, cameras: u8) -> Frame {
    let mut tracks = Vec::new();
    // Nothing is tracked in the third image.
    if index != 2 {
        for camera in 0..cameras {
            tracks.extend((0..5).map(|feature| TrackObservation {
                camera,
                feature_id: feature + index as u64,
                pixel: Vector2::new(rng.random_range(0.0..752.0), rng.random_range(0.0..480.0)),
            }));
        }
    }
    // Of camera 0 of every third image, of the others of the next ones.
    let with_features =
        (0..usize::from(cameras)).filter(|camera| (index as usize + 2 * camera).is_multiple_of(3));
    let mut set = || FeatureSet {
        pixels: (0..4).map(|_| [rng.random_range(0.0..752.0), rng.random_range(0.0..480.0)]).collect(),
        descriptors: Descriptors {
            kind: DescriptorKind::Binary,
            width: 32,
            bytes: (0..4 * 32).map(|_| rng.random()).collect(),
        },
        extractor: String::new(),
    };
    let features = with_features.map(|camera| (camera, set())).collect();
    Frame { stamp_ns: START_NS + index * 100_000_001, images: BTreeMap::new(), tracks, features }
}

fn truth_row(rng: &mut StdRng, index: i64) -> TruthRow {
    let known = index != 4;
    TruthRow {
        stamp_ns: START_NS + index * 100_000_001 - 97_500_000,
        pose: pose(rng),
        velocity: known.then(|| vector(rng, 2.0)),
        gyroscope_bias: known.then(|| vector(rng, 0.01)),
        accelerometer_bias: (known && index != 5).then(|| vector(rng, 0.1)),
    }
}
