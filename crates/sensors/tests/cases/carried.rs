//! Bags that carry their calibration: `CameraInfo` and `/tf_static`.

use super::making::{IMAGES, MS, NOISE, READINGS, START_NS, reading};
use geometry::camera::{Camera, Distortion};
use geometry::{Pose, rotation};
use nalgebra::Vector3;
use ros_messages::builtin_interfaces::Time;
use ros_messages::geometry_msgs::{Transform, TransformStamped};
use ros_messages::sensor_msgs::{CameraInfo, Image};
use ros_messages::std_msgs::Header;
use ros_messages::tf2_msgs::TFMessage;
use ros_messages::{RosMessage, encode};
use sensors::ros::{RosSensors, camera_info_message, imu_message, pixels_message};
use sensors::ros_bag::{RosBagWriter, message_type};
use sensors::{CalibrationFiles, ImuNoise, ImuSensor, Recording, SensorCalibration};
use std::path::{Path, PathBuf};
use tempfile::TempDir;
use vision::GrayImage;

fn pose(turn: f64, x: f64) -> Pose {
    Pose::new(rotation::exp(&Vector3::new(turn, 0.4, -turn)), Vector3::new(x, 0.1, -0.2))
}

fn stamped(parent: &str, child: &str, pose: &Pose) -> TransformStamped {
    let [x, y, z, w] = pose.rotation.coords.into();
    let rotation = ros_messages::geometry_msgs::Quaternion { x, y, z, w };
    let translation = <[f64; 3]>::from(pose.translation).into();
    let header = Header { stamp: Time::default(), frame_id: parent.to_owned() };
    TransformStamped {
        header,
        child_frame_id: child.to_owned(),
        transform: Transform { translation, rotation },
    }
}

fn camera(index: usize) -> Camera {
    let distortion = [
        Distortion::Equidistant([0.01, -0.02, 0.003, 0.0004]),
        Distortion::Rational([-0.3, 0.1, 1e-4, 2e-4, 0.01, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
    ];
    let (focal, centre) = ([8.0 + index as f64, 9.0], [4.0, 3.0]);
    Camera { width: 8, height: 6, focal, centre, distortion: distortion[index] }
}

/// What a recording carries beside readings and images.
struct Carried {
    infos: Vec<CameraInfo>,
    transforms: Vec<TransformStamped>,
    imu: Option<ImuSensor>,
    /// Frame of the readings.
    imu_frame: &'static str,
}

impl Carried {
    /// Two cameras on a plate, which is on the robot as the IMU is.
    fn complete() -> Self {
        let info = |(index, frame): (usize, &&str)| {
            camera_info_message(&camera(index), Header::new(START_NS, frame).unwrap())
        };
        Self {
            infos: ["left_optical", "right_optical"].iter().enumerate().map(info).collect(),
            transforms: vec![
                stamped("base_link", "imu_link", &pose(0.2, 1.0)),
                stamped("base_link", "plate", &pose(-0.7, 2.0)),
                stamped("plate", "left_optical", &pose(1.0, 0.1)),
                stamped("plate", "right_optical", &pose(1.1, 0.3)),
            ],
            imu: None,
            imu_frame: "imu_link",
        }
    }

    /// `imu_from_camera` of both cameras.
    fn mounted() -> [Pose; 2] {
        let imu_from_plate = pose(0.2, 1.0).inverse() * pose(-0.7, 2.0);
        [imu_from_plate * pose(1.0, 0.1), imu_from_plate * pose(1.1, 0.3)]
    }

    fn write(&self) -> (TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("drive.mcap");
        let mut bag = RosBagWriter::create(&path, bags::Format::Mcap).unwrap();
        if let Some(imu) = &self.imu {
            let calibration = SensorCalibration { imu: Some(imu.clone()), ..SensorCalibration::default() };
            bag.write_sensors(&RosSensors::new(&[self.imu_frame.to_owned()], &[]), &calibration).unwrap();
        }
        if !self.transforms.is_empty() {
            put(&mut bag, "/tf_static", START_NS, &TFMessage { transforms: self.transforms.clone() });
        }
        for reading in (0..READINGS).map(reading) {
            put(&mut bag, "/imu", reading.stamp_ns, &imu_message(&reading, self.imu_frame).unwrap());
        }
        for stamp_ns in (0..IMAGES).map(|index| START_NS + index * 50 * MS) {
            for camera in 0..2 {
                let header = Header::new(stamp_ns, "not asked for").unwrap();
                let image: Image = pixels_message(&GrayImage::from_fn(8, 6, |x, y| (x * y) as u8), header);
                put(&mut bag, &format!("/cam{camera}/image_raw"), stamp_ns, &image);
                if let Some(info) = self.infos.get(camera) {
                    put(&mut bag, &format!("/cam{camera}/camera_info"), stamp_ns, info);
                }
            }
        }
        bag.finish().unwrap();
        (folder, path)
    }
}

fn put<M: RosMessage>(bag: &mut RosBagWriter, topic: &str, log_ns: i64, message: &M) {
    bag.write(topic, message_type::<M>, log_ns, &encode(message).unwrap()).unwrap();
}

fn noise_file(folder: &Path) -> CalibrationFiles {
    // Elsewhere, so that it is not found by itself.
    let path = folder.join("noise").join("imu.yaml");
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(&path, NOISE).unwrap();
    let mut files = CalibrationFiles::default();
    files.imu = Some(path);
    files
}

#[test]
fn cameras_are_where_tf_static_says_with_the_projection_of_camera_info() {
    let (folder, path) = Carried::complete().write();
    let recording = Recording::open_with(&path, &noise_file(folder.path())).unwrap();
    let found = recording.calibration();
    assert!((found.imu.as_ref().unwrap().noise.gyroscope - 1e-4).abs() < 1e-15);
    for (index, (found, expected)) in found.cameras.iter().zip(Carried::mounted()).enumerate() {
        assert_eq!(found.camera, camera(index));
        assert!(found.imu_from_camera.local(&expected).norm() < 1e-12, "cam{index}");
    }
    // What nobody can know of a bag is asked for.
    let error = Recording::open(&path).unwrap_err().to_string();
    assert!(error.contains("noise of the IMU") && error.contains("--imu-calibration"), "{error}");
}

#[test]
fn what_is_missing_is_named() {
    let refused = |change: &dyn Fn(&mut Carried)| {
        let mut carried = Carried::complete();
        change(&mut carried);
        let (folder, path) = carried.write();
        Recording::open_with(&path, &noise_file(folder.path())).unwrap_err().to_string()
    };
    let unmounted = refused(&|carried| drop(carried.transforms.pop()));
    assert!(unmounted.contains("\"right_optical\"") && unmounted.contains("/tf_static"), "{unmounted}");
    assert!(unmounted.contains("--calibration"), "{unmounted}");
    let unknown = refused(&|carried| drop(carried.infos.pop()));
    assert!(unknown.contains("no CameraInfo of /cam1/image_raw"), "{unknown}");
    let nameless = refused(&|carried| carried.imu_frame = "");
    assert!(nameless.contains("\"\""), "{nameless}");
    let tilted = refused(&|carried| {
        carried.infos[1].d.resize(14, 0.0);
        carried.infos[1].d[12] = 0.1;
    });
    assert!(tilted.contains("coefficient 13"), "{tilted}");
}

#[test]
fn the_base_is_where_tf_static_says_over_any_frames() {
    let imu_from_base = |carried: &Carried, base: &str| {
        let (folder, path) = carried.write();
        Recording::open_with(&path, &noise_file(folder.path())).unwrap().imu_from_base(base)
    };
    let mut carried = Carried::complete();
    let expected = pose(0.2, 1.0).inverse();
    assert!(imu_from_base(&carried, "base_link").unwrap().local(&expected).norm() < 1e-12);
    // As robot descriptions have it.
    carried.transforms.push(stamped("base_footprint", "base_link", &pose(0.0, 0.3)));
    let footprint = imu_from_base(&carried, "/base_footprint").unwrap();
    assert!(footprint.local(&(pose(0.0, 0.3) * pose(0.2, 1.0)).inverse()).norm() < 1e-12);
    assert_eq!(imu_from_base(&carried, "trailer"), None);
    carried.imu_frame = "";
    let (folder, path) = carried.write();
    assert!(
        Recording::open_with(&path, &noise_file(folder.path())).is_err(),
        "the cameras' place is not known"
    );
}

#[test]
fn scale_and_misalignment_are_taken_out_once() {
    const SCALED: &str = "model: scale-misalignment\naccelerometers: {M: [[1, 0, 0], [0, 1.25, 0], [0, 0, 1]]}\n\
        gyroscopes: {M: [[1, 0, 0], [0, 1.4, 0], [0, 0, 1]]}\n";
    let first = |imu: Option<ImuSensor>| {
        let (folder, path) = Carried { imu, ..Carried::complete() }.write();
        let files = noise_file(folder.path());
        std::fs::write(files.imu.as_ref().unwrap(), format!("{NOISE}\n{SCALED}")).unwrap();
        let recording = Recording::open_with(&path, &files).unwrap();
        recording.imu_samples().unwrap().next().unwrap().unwrap()
    };
    let recorded = reading(0);
    let corrected = first(None);
    let expected = (recorded.gyroscope.y / 1.4, recorded.accelerometer.y / 1.25);
    assert!((corrected.gyroscope.y - expected.0).abs() < 1e-12);
    assert!((corrected.accelerometer.y - expected.1).abs() < 1e-12);
    // Driftless has recorded the readings without them.
    let imu = ImuSensor { noise: noise(), rate_hz: 200.0, gravity_magnitude: None, intrinsics: None };
    assert_eq!(first(Some(imu)).gyroscope, recorded.gyroscope);
}

fn noise() -> ImuNoise {
    let mut noise = ImuNoise::default();
    (noise.gyroscope, noise.gyroscope_walk) = (1.0 / 7e3, 1.0 / 3e5);
    (noise.accelerometer, noise.accelerometer_walk) = (1.0 / 9e2, 1.0 / 1.1e4);
    noise
}

#[test]
fn the_noise_that_driftless_writes_is_read_with_all_digits_and_files_come_first() {
    let imu = ImuSensor { noise: noise(), rate_hz: 200.0, gravity_magnitude: Some(9.79), intrinsics: None };
    let (folder, path) = Carried { imu: Some(imu.clone()), ..Carried::complete() }.write();
    let recording = Recording::open(&path).unwrap();
    assert_eq!(recording.calibration().imu, Some(imu));
    let given = Recording::open_with(&path, &noise_file(folder.path())).unwrap();
    assert!((given.calibration().imu.as_ref().unwrap().noise.gyroscope - 1e-4).abs() < 1e-15);
}

#[test]
fn a_time_shift_is_not_added_twice() {
    const SHIFTED: &str = "cam0:\n  T_cam_imu: [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n  \
        timeshift_cam_imu: 0.01\ncam1:\n  T_cn_cnm1: [[1, 0, 0, -0.1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n";
    let first_ns = |imu: Option<ImuSensor>| {
        let (folder, path) = Carried { imu, ..Carried::complete() }.write();
        std::fs::write(path.with_extension("yaml"), SHIFTED).unwrap();
        let recording = Recording::open_with(&path, &noise_file(folder.path())).unwrap();
        let mut frames = recording.frames().unwrap();
        frames.next().unwrap().unwrap().stamp_ns - START_NS
    };
    assert_eq!(first_ns(None), 10 * MS);
    // Driftless has recorded the images on the clock of the IMU.
    let imu = ImuSensor { noise: noise(), rate_hz: 200.0, gravity_magnitude: None, intrinsics: None };
    assert_eq!(first_ns(Some(imu)), 0);
}
