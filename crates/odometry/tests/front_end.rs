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
    photograph_of(&sensor(), k)
}

fn photograph_of(sensor: &CameraSensor, k: i64) -> GrayImage {
    photograph_after(sensor, (k * PERIOD_NS) as f64 * 1e-9)
}

/// What a camera sees after so many seconds of turning with [`RATE`].
fn photograph_after(sensor: &CameraSensor, seconds: f64) -> GrayImage {
    let CameraSensor { camera, imu_from_camera, .. } = sensor;
    let world_from_imu = exp(&(RATE * seconds));
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
    Frame { stamp_ns: k * PERIOD_NS, images: [(0, path.into())].into(), ..Frame::default() }
}

/// The same camera turned about its vertical axis by so many degrees: it sees nothing of what the other sees.
fn turned(degrees: f64) -> CameraSensor {
    let CameraSensor { camera, imu_from_camera, .. } = sensor();
    let turn = Pose::new(exp(&(Vector3::y() * degrees.to_radians())), Vector3::zeros());
    CameraSensor::new(camera, imu_from_camera * turn, 20.0)
}

fn front_end() -> FrontEnd {
    FrontEnd::new(&[sensor()], &TrackerOptions::default().points(100)).unwrap()
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
fn the_gyroscope_is_read_at_the_times_of_the_images_by_its_own_clock() {
    const OFFSET_NS: i64 = 100_000_000;
    // The camera turns faster and faster: by the wrong clock the gyroscope would be off by 0.13 rad/s.
    let reading = |k: i64| ImuSample {
        stamp_ns: k * PERIOD_NS / 10 + OFFSET_NS,
        gyroscope: RATE * (1.0 + 2.0 * (k * PERIOD_NS / 10) as f64 * 1e-9),
        accelerometer: Vector3::new(0.0, 0.0, 9.81),
    };
    let readings: Vec<ImuSample> = (0..=200).map(reading).collect();
    let mut front_end = front_end();
    front_end.set_time_offset_ns(OFFSET_NS);
    for k in 0..15 {
        let seconds = (k * PERIOD_NS) as f64 * 1e-9;
        let image = photograph_after(&sensor(), seconds + seconds * seconds);
        let images = [(0, image.into())].into();
        let frame = Frame { stamp_ns: k * PERIOD_NS, images, ..Frame::default() };
        front_end.track_frame(&frame, &readings).unwrap();
    }
    let off = front_end.gyroscope_bias();
    assert!(off.norm() < 0.03, "off by {off:?} rad/s");
    assert_eq!(front_end.last_stamp_ns(), Some(14 * PERIOD_NS + OFFSET_NS));
}

#[test]
fn a_damaged_image_is_named_and_the_tracks_go_on_after_it() {
    let folder = tempfile::tempdir().unwrap();
    let imu = readings(&Vector3::zeros());
    let mut front_end = front_end();
    let before = front_end.track_frame(&frame(folder.path(), 0), &imu).unwrap();
    let damaged = frame(folder.path(), 1);
    let path = damaged.images[&0].path().unwrap();
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

#[test]
fn cameras_of_a_rig_are_tracked_as_each_alone_and_one_that_fails_does_not_stop_the_others() {
    let rig = [sensor(), turned(180.0), turned(90.0)];
    let options = TrackerOptions::default().points(60);
    let imu = readings(&Vector3::zeros());
    let of_rig = |k: i64, cameras: &[usize]| {
        let image = |&camera: &usize| (camera, photograph_of(&rig[camera], k).into());
        Frame { stamp_ns: k * PERIOD_NS, images: cameras.iter().map(image).collect(), ..Frame::default() }
    };
    let mut all = FrontEnd::new(&rig, &options).unwrap();
    let mut alone: Vec<FrontEnd> =
        rig.iter().map(|sensor| FrontEnd::new(std::slice::from_ref(sensor), &options).unwrap()).collect();
    // Biases are learned from all cameras together: known here, so that each camera has the same prediction.
    for front_end in alone.iter_mut().chain([&mut all]) {
        front_end.set_gyroscope_bias(Vector3::zeros());
    }
    for k in 0..2 {
        let tracks = all.track_frame(&of_rig(k, &[0, 1, 2]), &imu).unwrap();
        let ids: BTreeSet<u64> = tracks.iter().map(|track| track.feature_id).collect();
        assert_eq!(ids.len(), tracks.len(), "no identity is that of two points");
        for (camera, front_end) in alone.iter_mut().enumerate() {
            let frame = Frame {
                stamp_ns: k * PERIOD_NS,
                images: [(0, photograph_of(&rig[camera], k).into())].into(),
                ..Frame::default()
            };
            let own = front_end.track_frame(&frame, &imu).unwrap();
            let of_camera: Vec<_> =
                tracks.iter().filter(|track| usize::from(track.camera) == camera).collect();
            assert!(own.len() > 30 && own.len() == of_camera.len());
            for (own, of_rig) in own.iter().zip(of_camera) {
                let groups = rig.len() as u64;
                assert_eq!(of_rig.feature_id, own.feature_id * groups + camera as u64);
                // Later images differ by the bias that the cameras learn in the meantime.
                assert!((of_rig.pixel - own.pixel).norm() < 0.05);
            }
        }
    }
    // Camera 0 is dead, camera 1 sends half an image: camera 2 goes on, and later all of them.
    let mut damaged = of_rig(2, &[2]);
    damaged.images.insert(1, Path::new("missing.png").to_path_buf().into());
    let tracks = all.track_frame(&damaged, &imu).unwrap();
    assert!(tracks.len() > 30 && tracks.iter().all(|track| track.camera == 2));
    let tracks = all.track_frame(&of_rig(3, &[0, 1, 2]), &imu).unwrap();
    let cameras: BTreeSet<u8> = tracks.iter().map(|track| track.camera).collect();
    assert_eq!(cameras, BTreeSet::from([0, 1, 2]));
    assert!(all.report().continued > 60, "{:?}", all.report());
    // Without any image there are no tracks.
    assert!(matches!(all.track_frame(&of_rig(4, &[]), &imu), Err(FrontEndError::NoImage { .. })));
}
