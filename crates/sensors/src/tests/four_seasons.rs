//! Recordings in the layout of 4Seasons.

use super::*;
use std::fmt::Write as _;
use vision::GrayImage;

const IMAGE_NS: i64 = 33_000_000;
const SCALE: f64 = 0.969_397;
/// A chain as `kalibr_calibrate_cameras` writes it: without the IMU.
const CHAIN: &str = "cam0:
  camera_model: pinhole
  intrinsics: [501.4, 501.3, 421.7, 167.6]
  distortion_model: equidistant
  distortion_coeffs: [0.01, -0.02, 0.003, -0.0004]
  resolution: [800, 400]
cam1:
  camera_model: pinhole
  intrinsics: [500.4, 500.3, 420.7, 168.6]
  distortion_model: equidistant
  distortion_coeffs: [0.02, -0.01, 0.002, -0.0003]
  resolution: [800, 400]
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.3]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
";

/// A translation and a quaternion (x, y, z, w).
fn numbers(pose: &Pose) -> String {
    let ([x, y, z], q) = (pose.translation.into(), pose.rotation.coords);
    let numbers: [f64; 7] = [x, y, z, q.x, q.y, q.z, q.w];
    numbers.map(|number| number.to_string()).join(",")
}

struct Written {
    folder: tempfile::TempDir,
    camera_from_imu: Pose,
    gpsw_from_world: Pose,
    world_from_camera: Vec<Pose>,
}

impl Written {
    fn root(&self) -> PathBuf {
        self.folder.path().join("recording_1")
    }

    /// The message of the error after a file was changed.
    fn error_after(&self, file: &str, change: impl Fn(&str) -> String) -> String {
        let path = self.root().join(file);
        let before = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, change(&before)).unwrap();
        let error = Sequence::open(&self.root()).map(drop).unwrap_err().to_string();
        std::fs::write(&path, before).unwrap();
        error
    }
}

/// Twelve images, of which one of camera 1 is lost, one second of readings, and a keyframe of every third image.
fn written() -> Written {
    let folder = tempfile::tempdir().unwrap();
    let mut rng = StdRng::seed_from_u64(4);
    let [camera_from_imu, metric_from_world, world_from_gpsw] = [(); 3].map(|()| pose(&mut rng));
    let root = folder.path().join("recording_1");
    let calibration = folder.path().join("calibration");
    std::fs::create_dir_all(&calibration).unwrap();
    std::fs::write(calibration.join("camchain.yaml"), CHAIN).unwrap();
    let image = GrayImage::from_fn(800, 400, |x, y| (x + y) as u8);
    let (mut times, mut poses) = (String::new(), "frame_id,t_x,t_y,t_z,q_x,q_y,q_z,q_w,scale\n".to_owned());
    let mut world_from_camera = Vec::new();
    for index in 0..12 {
        let stamp_ns = START_NS + index * IMAGE_NS;
        let micros = (stamp_ns + 500) / 1000;
        let _ = writeln!(times, "{stamp_ns} {}.{:06} 1.25", micros / 1_000_000, micros % 1_000_000);
        for camera in 0..2 {
            let images = root.join(format!("distorted_images/cam{camera}"));
            std::fs::create_dir_all(&images).unwrap();
            if (index, camera) != (5, 1) {
                image.write(&images.join(format!("{stamp_ns}.png"))).unwrap();
            }
        }
        if index % 3 == 0 {
            let pose = pose(&mut rng);
            let _ = writeln!(poses, "{stamp_ns},{},{SCALE},1,1", numbers(&pose));
            world_from_camera.push(pose);
        }
    }
    let readings = (0..2000).fold(String::new(), |mut text, index| {
        let _ = writeln!(text, "{} 0.01 -0.02 0.03 0.1 -0.3 9.75", START_NS + index * 500_000);
        text
    });
    let transforms = format!(
        "# transform_S_AS: translation vector, rotation quaternion\n{}\n\n# TS_cam_imu: translation vector, rotation quaternion\n{}\n\n\
         # transform_w_gpsw: translation vector, rotation quaternion\n{}\n\n# GNSS scale\n0.97\n",
        numbers(&metric_from_world),
        numbers(&camera_from_imu),
        numbers(&world_from_gpsw)
    );
    let files = [
        ("times.txt", times),
        ("imu.txt", readings),
        ("Transformations.txt", transforms),
        ("GNSSPoses.txt", poses),
    ];
    for (file, text) in files {
        std::fs::write(root.join(file), text).unwrap();
    }
    let gpsw_from_world = world_from_gpsw.inverse() * metric_from_world;
    Written { folder, camera_from_imu, gpsw_from_world, world_from_camera }
}

#[test]
fn a_recording_is_read_with_calibration_images_and_truth() {
    let written = written();
    let read = Sequence::open(&written.root()).unwrap();
    assert_eq!((read.frames.len(), read.imu_samples.len()), (12, 2000));
    let images: Vec<usize> = read.frames.iter().map(|frame| frame.images.len()).collect();
    assert_eq!(images, [2, 2, 2, 2, 2, 1, 2, 2, 2, 2, 2, 2]);
    let imu = read.imu.unwrap();
    assert!((imu.rate_hz - 2000.0).abs() < 1e-6 && (read.cameras[0].rate_hz - 1e3 / 33.0).abs() < 1e-6);
    // The right camera is 0.3 m to the right.
    let right_from_left = read.cameras[1].imu_from_camera.inverse() * read.cameras[0].imu_from_camera;
    assert!((right_from_left.translation - Vector3::new(-0.3, 0.0, 0.0)).norm() < 1e-9);
    let on_imu = read.cameras[0].imu_from_camera * written.camera_from_imu;
    assert!(on_imu.translation.norm() < 1e-9 && on_imu.rotation.angle() < 1e-9);

    let truth = read.groundtruth.unwrap();
    assert_eq!(truth.len(), written.world_from_camera.len());
    for (row, world_from_camera) in truth.iter().zip(&written.world_from_camera) {
        // A point at the IMU, step by step.
        let in_camera = written.camera_from_imu.transform(&Vector3::zeros());
        let in_world = world_from_camera.rotation * in_camera + world_from_camera.translation * SCALE;
        let in_gpsw = written.gpsw_from_world.transform(&in_world);
        assert!((row.pose.translation - in_gpsw).norm() < 1e-9);
    }
}

#[test]
fn what_is_missing_or_wrong_is_named() {
    let written = written();
    let short = written.error_after("imu.txt", |text| text.replacen(" 9.75", "", 1));
    assert!(short.contains("imu.txt, line 1") && short.contains("cut off"), "{short}");
    let order = written.error_after("times.txt", |text| {
        let mut lines: Vec<&str> = text.lines().collect();
        lines.swap(3, 4);
        lines.join("\n")
    });
    assert!(order.contains("times.txt, line 5") && order.contains("is not after"), "{order}");
    let other = written.error_after("times.txt", |text| text.replacen(".938", ".738", 1));
    assert!(other.contains("times.txt, line 1") && other.contains("frame id"), "{other}");
    let images = written.error_after("times.txt", |_| "1500000000000000000 1500000000.0 1.0\n".to_owned());
    assert!(images.contains("distorted_images"), "{images}");
    let mounting = written.error_after("Transformations.txt", |text| text.replace("TS_cam_imu", "other"));
    assert!(mounting.contains("TS_cam_imu"), "{mounting}");
    let turned = written
        .error_after("GNSSPoses.txt", |text| text.replace(",0.969397,", ",").replacen("-0.", "-7.", 3));
    assert!(turned.contains("GNSSPoses.txt, line"), "{turned}");

    // Without poses of GNSS there is no truth, without a calibration there is nothing.
    std::fs::remove_file(written.root().join("GNSSPoses.txt")).unwrap();
    assert!(Sequence::open(&written.root()).unwrap().groundtruth.is_none_or(|truth| truth.is_empty()));
    std::fs::remove_dir_all(written.folder.path().join("calibration")).unwrap();
    let missing = Sequence::open(&written.root()).map(drop).unwrap_err().to_string();
    assert!(missing.contains("camchain.yaml") && missing.contains("--calibration"), "{missing}");
}
