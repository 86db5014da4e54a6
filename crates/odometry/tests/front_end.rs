//! Laws of the front end: from image files and a gyroscope to tracks.
#![allow(clippy::unwrap_used)]

use geometry::rotation::exp;
use geometry::{Camera, Distortion, Pose};
use nalgebra::{Vector2, Vector3};
use odometry::{FrontEnd, FrontEndError};
use sensors::{CameraSensor, Frame, ImuSample};
use std::collections::BTreeSet;
use std::path::Path;
use vision::GrayImage;
use vision::tracking::TrackerOptions;

const PERIOD_NS: i64 = 50_000_000;
/// How the camera turns, rad/s in the IMU frame: 12 px an image.
const RATE: Vector3<f64> = Vector3::new(0.2, -0.5, 0.4);

fn sensor() -> CameraSensor {
    let camera = Camera {
        width: 376,
        height: 240,
        focal: [230.0; 2],
        centre: [187.5, 119.5],
        distortion: Distortion::None,
    };
    let imu_from_camera = Pose::new(exp(&Vector3::new(0.3, 1.2, -0.8)), Vector3::new(0.05, 0.0, -0.02));
    CameraSensor::new(camera, imu_from_camera, 20.0)
}

/// What the camera sees after `k` images of turning: a texture on a sphere, infinitely far.
fn photograph(k: i64) -> GrayImage {
    let CameraSensor { camera, imu_from_camera, .. } = sensor();
    let world_from_imu = exp(&(RATE * (k * PERIOD_NS) as f64 * 1e-9));
    let world_from_camera = world_from_imu * imu_from_camera.rotation;
    GrayImage::from_fn(376, 240, |x, y| {
        let ray = camera.bearing(&Vector2::new(x as f64, y as f64)).unwrap();
        let d = world_from_camera * ray.into_inner();
        // Waves of 15 to 50 px in directions that have nothing to do with each other.
        let wave = |a: f64, b: f64, c: f64| (a * d.x + b * d.y + c * d.z).sin();
        let sum = wave(71.0, 13.0, -37.0)
            + wave(-23.0, 64.0, 45.0)
            + wave(31.0, 42.0, 83.0)
            + wave(55.0, -77.0, 19.0)
            + wave(-90.0, 35.0, 8.0);
        (128.0 + 22.0 * sum) as u8
    })
}

fn readings(bias: &Vector3<f64>) -> Vec<ImuSample> {
    let sample = |k: i64| ImuSample {
        stamp_ns: k * PERIOD_NS / 10,
        gyroscope: RATE + bias,
        accelerometer: Vector3::new(0.0, 0.0, 9.81),
    };
    (0..=1000).map(sample).collect()
}

fn frame(folder: &Path, k: i64) -> Frame {
    let path = folder.join(format!("{k}.png"));
    photograph(k).write(&path).unwrap();
    Frame { stamp_ns: k * PERIOD_NS, images: [Some(path.into()), None], ..Frame::default() }
}

fn front_end() -> FrontEnd {
    FrontEnd::new(&[sensor()], TrackerOptions::default().points(100)).unwrap()
}

#[test]
fn the_bias_of_the_gyroscope_is_learned_from_the_images() {
    let folder = tempfile::tempdir().unwrap();
    let bias = Vector3::new(0.06, -0.05, 0.08);
    let mut front_end = front_end();
    for k in 0..15 {
        front_end.track_frame(&frame(folder.path(), k), &readings(&bias)).unwrap();
    }
    let off = front_end.gyroscope_bias() - bias;
    assert!(off.norm() < 0.01, "off by {off:?} rad/s");
    assert!(front_end.report().continued > 60);
}

#[test]
fn a_damaged_image_is_named_and_the_tracks_go_on_after_it() {
    let folder = tempfile::tempdir().unwrap();
    let imu = readings(&Vector3::zeros());
    let mut front_end = front_end();
    let before = front_end.track_frame(&frame(folder.path(), 0), &imu).unwrap();
    let damaged = frame(folder.path(), 1);
    let path = damaged.images[0].as_ref().unwrap().path().unwrap();
    let whole = std::fs::read(path).unwrap();
    std::fs::write(path, &whole[..whole.len() / 2]).unwrap();
    let error = front_end.track_frame(&damaged, &imu).unwrap_err();
    assert!(error.to_string().contains("1.png"), "{error}");
    let empty = Frame { stamp_ns: 2 * PERIOD_NS, ..Frame::default() };
    assert!(matches!(front_end.track_frame(&empty, &imu), Err(FrontEndError::NoImage { .. })));
    let after = front_end.track_frame(&frame(folder.path(), 3), &imu).unwrap();
    let ids: BTreeSet<u64> = before.iter().map(|track| track.feature_id).collect();
    let kept = after.iter().filter(|track| ids.contains(&track.feature_id)).count();
    assert!(kept > 50, "{kept} tracks continued over 36 px, which only the gyroscope predicts");
}
