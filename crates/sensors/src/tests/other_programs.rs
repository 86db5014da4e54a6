//! Calibrations of other programs: read where their meaning is clear, else named.

use super::*;
use crate::read_rig_calibration;
use nalgebra::{UnitQuaternion, Vector3};

/// A camera that looks along the IMU's y axis.
fn imu_from_camera() -> Pose {
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -std::f64::consts::FRAC_PI_2);
    Pose::new(rotation, Vector3::new(0.25, -0.5, 0.125))
}

/// The numbers of a pose's matrix in rows.
fn rows(pose: &Pose) -> Vec<Vec<f64>> {
    let (rotation, p) = (pose.rotation.to_rotation_matrix(), pose.translation);
    let row = |index: usize| vec![rotation[(index, 0)], rotation[(index, 1)], rotation[(index, 2)], p[index]];
    vec![row(0), row(1), row(2), vec![0.0, 0.0, 0.0, 1.0]]
}

const LENS: &str = "  camera_model: pinhole\n  distortion_coeffs: [0.1, 0.2, 0.003, 0.004]\n  distortion_model: radtan\n  \
                    intrinsics: [400, 401.5, 320, 240]\n  resolution: [640, 480]\n  rostopic: /cam0/image_raw\n";
const NOISE: &str = "accelerometer_noise_density: 2.0e-3  # white\n  accelerometer_random_walk: 3.0e-3\n  \
                     gyroscope_noise_density: 1.6968e-04\n  gyroscope_random_walk: 1.9393e-05\n";

fn identity(name: &str) -> String {
    format!("  {name}:\n    - [ 1.0, 0.0, 0.0 ]\n    - [ 0.0, 1.0, 0.0 ]\n    - [ 0.0, 0.0, 1.0 ]\n")
}

/// As OpenVINS ships it.
fn openvins_imu() -> String {
    format!(
        "%YAML:1.0\n\nimu0:\n  T_i_b:\n    - [1.0, 0.0, 0.0, 0.0]\n    - [0.0, 1.0, 0.0, 0.0]\n    - [0.0, 0.0, 1.0, 0.0]\n    - \
         [0.0, 0.0, 0.0, 1.0]\n  {NOISE}  time_offset: 0.0\n  update_rate: 200.0\n  model: \"kalibr\"\n{}{}{}{}  Tg:\n    - [ 0.0, \
         0.0, 0.0 ]\n    - [ 0.0, 0.0, 0.0 ]\n    - [ 0.0, 0.0, 0.0 ]\n",
        identity("Tw"),
        identity("R_IMUtoGYRO"),
        identity("Ta"),
        identity("R_IMUtoACC")
    )
}

/// Kimera's file of a camera.
fn kimera_camera(id: &str, pose: &Pose) -> String {
    format!(
        "%YAML:1.0\n# General sensor definitions.\ncamera_id: {id}\n\nT_BS:\n  cols: 4\n  rows: 4\n  data: {:?}\nrate_hz: \
         20\nresolution: [640, 480]\ncamera_model: pinhole\nintrinsics: [400, 401.5, 320, 240] #fu, fv, cu, cv\ndistortion_model: \
         radial-tangential\ndistortion_coefficients: [0.1, 0.2, 0.003, 0.004]\n",
        rows(pose).concat()
    )
}

fn kimera_imu() -> String {
    let noise = NOISE.replace("\n  ", "\n");
    format!(
        "%YAML:1.0\nimu_preintegration_type: 1\nT_BS:\n  cols: 4\n  rows: 4\n  data: {:?}\nrate_hz: 200\n{noise}imu_time_shift: \
         0.0125\nn_gravity: [0.0, 0.0, -9.81]\n",
        rows(&Pose::identity()).concat()
    )
}

/// Settings of ORB-SLAM3.
fn orb_slam3(left: &Pose, right: &Pose) -> String {
    let matrix = |name: &str, pose: &Pose| {
        format!("{name}: !!opencv-matrix\n  rows: 4\n  cols: 4\n  dt: f\n  data: {:?}\n", rows(pose).concat())
    };
    let camera = |name: &str| {
        let entries = [
            "fx: 400.0",
            "fy: 401.5",
            "cx: 320.0",
            "cy: 240.0",
            "k1: 0.1",
            "k2: 0.2",
            "p1: 0.003",
            "p2: 0.004",
        ];
        entries.map(|entry| format!("{name}.{entry}\n")).concat()
    };
    format!(
        "%YAML:1.0\nFile.version: \"1.0\"\nCamera.type: \"PinHole\"\n{}{}Camera.width: 640\nCamera.height: 480\nCamera.RGB: \
         1\n{}{}IMU.NoiseGyro: 1.6968e-04 # white\nIMU.NoiseAcc: 2.0e-03\nIMU.GyroWalk: 1.9393e-05\nIMU.AccWalk: \
         3.0e-03\nIMU.Frequency: 200.0\nORBextractor.nFeatures: 1200\n",
        camera("Camera1"),
        camera("Camera2"),
        matrix("Stereo.T_c1_c2", &(left.inverse() * *right)),
        matrix("IMU.T_b_c1", left)
    )
}

/// A calibration of Basalt.
fn basalt(imu_from_cameras: &[Pose]) -> String {
    let pose = |pose: &Pose| {
        let (p, q) = (pose.translation, pose.rotation.coords);
        format!(
            r#"{{"px": {}, "py": {}, "pz": {}, "qx": {}, "qy": {}, "qz": {}, "qw": {}}}"#,
            p.x, p.y, p.z, q.x, q.y, q.z, q.w
        )
    };
    let each =
        |text: &dyn Fn(&Pose) -> String| imu_from_cameras.iter().map(text).collect::<Vec<_>>().join(", ");
    let lens = r#"{"camera_type": "pinhole-radtan8", "intrinsics": {"fx": 400.0, "fy": 401.5, "cx": 320.0, "cy": 240.0, "k1": 0.1,
        "k2": 0.2, "p1": 0.003, "p2": 0.004, "k3": 0.0, "k4": 0.0, "k5": 0.0, "k6": 0.0, "rpmax": 2.7}}"#;
    format!(
        r#"{{"value0": {{"T_imu_cam": [{}], "intrinsics": [{}], "resolution": [{}], "calib_accel_bias": [0.1, 0.2, 0.3, 0, 0, 0, 0, 0, 0],
        "imu_update_rate": 200.0, "accel_noise_std": [0.002, 0.002, 0.002], "gyro_noise_std": [0.00016968, 0.00016968, 0.00016968],
        "accel_bias_std": [0.003, 0.003, 0.003], "gyro_bias_std": [1.9393e-5, 1.9393e-5, 1.9393e-5], "cam_time_offset_ns": 12500000,
        "vignette": []}}}}"#,
        each(&pose),
        each(&|_| lens.to_owned()),
        each(&|_| "[640, 480]".to_owned())
    )
}

/// Writes files into a folder and reads the calibration from one of them, or from the folder for an empty name.
fn read(files: &[(&str, String)], name: &str) -> Result<FolderCalibration, SequenceError> {
    let folder = tempfile::tempdir().unwrap();
    for (name, text) in files {
        std::fs::write(folder.path().join(name), text).unwrap();
    }
    read_rig_calibration(&folder.path().join(name), None, &[], &[])
}

#[test]
fn every_way_to_write_a_calibration_means_the_same() {
    let (pose, right) =
        (imu_from_camera(), imu_from_camera().compose(&Pose::new(UnitQuaternion::identity(), Vector3::x())));
    let chain = |entry: &str, pose: &Pose, flat: bool| {
        let matrix = if flat { format!("{:?}", rows(pose).concat()) } else { format!("{:?}", rows(pose)) };
        format!("cam0:\n  {entry}: {matrix}\n{LENS}")
    };
    let openvins = ("kalibr_imu_chain.yaml", openvins_imu());
    let chains = "kalibr_imucam_chain.yaml";
    let kimera = |id, name, pose| (name, kimera_camera(id, pose));
    let kimera_files = [
        kimera("left_cam", "LeftCameraParams.yaml", &pose),
        kimera("right_cam", "RightCameraParams.yaml", &right),
        ("ImuParams.yaml", kimera_imu()),
    ];
    let both = chain("T_cam_imu", &pose.inverse(), false)
        + "  timeshift_cam_imu: 0.0125\n"
        + &openvins_imu().replace("%YAML:1.0", "");
    for (name, files, cameras, offset_ns, path) in [
        ("OpenVINS", vec![(chains, chain("T_imu_cam", &pose, false)), openvins.clone()], 1, 0, chains),
        ("msckf_vio", vec![(chains, chain("T_cam_imu", &pose.inverse(), true)), openvins], 1, 0, chains),
        ("one file", vec![("all.yaml", both)], 1, 12_500_000, "all.yaml"),
        ("ORB-SLAM3", vec![("EuRoC.yaml", orb_slam3(&pose, &right))], 2, 0, "EuRoC.yaml"),
        ("ORB-SLAM3, folder", vec![("EuRoC.yaml", orb_slam3(&pose, &right))], 2, 0, ""),
        ("Basalt", vec![("euroc.json", basalt(&[pose, right]))], 2, 12_500_000, "euroc.json"),
        ("Kimera", kimera_files.to_vec(), 2, 12_500_000, "LeftCameraParams.yaml"),
        ("Kimera, folder", kimera_files.to_vec(), 2, 12_500_000, ""),
        ("Kimera, one camera", vec![kimera_files[0].clone(), kimera_files[2].clone()], 1, 12_500_000, ""),
    ] {
        let read = read(&files, path).unwrap_or_else(|error| panic!("{name}: {error}"));
        let imu = read.sensors.imu.unwrap();
        assert_eq!((imu.noise, imu.rate_hz), (ImuNoise::default(), 200.0), "{name}");
        assert_eq!((read.sensors.cameras.len(), read.time_offset_ns), (cameras, offset_ns), "{name}");
        for (camera, pose) in read.sensors.cameras.iter().zip([&pose, &right]) {
            assert!(camera.imu_from_camera.local(pose).amax() < 1e-9, "{name}");
            assert!((camera.camera.focal[1] - 401.5).abs() < 1e-9);
            assert_eq!(camera.camera.distortion, Distortion::RadialTangential([0.1, 0.2, 0.003, 0.004]));
        }
    }
}

/// A `sensor.yaml` of the EuRoC layout, too, which states by itself when its pixels are taken.
#[test]
fn a_camera_s_own_file_keeps_its_times() {
    let timed = kimera_camera("cam0", &imu_from_camera()) + "line_delay: 2.5e-05\ntimeshift_cam_imu: 0.03\n";
    let chain = |files: &[(&'static str, String)]| {
        let folder = tempfile::tempdir().unwrap();
        for (name, text) in files {
            std::fs::write(folder.path().join(name), text).unwrap();
        }
        calibration::kalibr::read_camera_chain(&folder.path().join("sensor.yaml"), &[None], &[0]).unwrap()
    };
    let read = chain(&[("sensor.yaml", timed.clone())]);
    assert_eq!((read.time_offset_ns, read.time_shifts_s.as_slice()), (30_000_000, [0.0].as_slice()));
    assert!((read.readouts_s[0] - 0.012).abs() < 1e-12, "{:?}", read.readouts_s);
    // Kimera's file of the IMU comes first.
    let read = chain(&[("sensor.yaml", timed), ("ImuParams.yaml", kimera_imu())]);
    assert_eq!(read.time_offset_ns, 12_500_000);
}

#[test]
fn the_camera_models_of_basalt_and_orb_slam3_are_read() {
    let pose = imu_from_camera();
    let pinhole = basalt(&[pose]);
    let from = pinhole.find(r#"{"camera_type""#).unwrap();
    let until = from + pinhole[from..].find("}}").unwrap() + 2;
    let of = |kind: &str, more: &str| {
        let lens = format!(
            r#"{{"camera_type": "{kind}", "intrinsics": {{"fx": 400.0, "fy": 401.5, "cx": 320.0, "cy": 240.0, {more}}}}}"#
        );
        let text = [&pinhole[..from], &lens, &pinhole[until..]].concat();
        read(&[("rig.json", text)], "rig.json").map(|read| read.sensors.cameras[0].camera.clone())
    };
    let rational = r#""k1": 0.1, "k2": 0.2, "p1": 0.003, "p2": 0.004, "k3": 0.5, "k4": 0.06, "k5": 0.07, "k6": 0.08, "rpmax": 2.7"#;
    let coefficients = [0.1, 0.2, 0.003, 0.004, 0.5, 0.06, 0.07, 0.08];
    for (kind, more, distortion) in [
        ("pinhole-radtan8", rational, Distortion::from_opencv(&coefficients).unwrap()),
        ("ds", r#""xi": -0.2, "alpha": 0.6"#, Distortion::DoubleSphere { xi: -0.2, alpha: 0.6 }),
        ("eucm", r#""alpha": 0.6, "beta": 1.1"#, Distortion::Eucm { alpha: 0.6, beta: 1.1 }),
        ("ucm", r#""alpha": 0.6"#, Distortion::Eucm { alpha: 0.6, beta: 1.0 }),
    ] {
        let camera = of(kind, more).unwrap();
        assert_eq!(
            (camera.distortion, camera.focal, camera.centre),
            (distortion, [400.0, 401.5], [320.0, 240.0])
        );
    }
    assert!(of("ds", r#""xi": -0.2"#).is_err(), "alpha is missing");
    assert!(of("fisheye", r#""k1": 0.1"#).unwrap_err().to_string().contains("\"fisheye\" is not read"));
    let with_k3 = orb_slam3(&pose, &pose).replace("Camera1.p2:", "Camera1.k3: 0.05\nCamera1.p2:");
    let camera = read(&[("EuRoC.yaml", with_k3)], "EuRoC.yaml").unwrap().sensors.cameras[0].camera.clone();
    assert_eq!(camera.distortion.coefficients(), [0.1, 0.2, 0.003, 0.004, 0.05]);
}

#[test]
fn what_is_not_read_is_named() {
    let chain = format!("cam0:\n  T_imu_cam: {:?}\n{LENS}", rows(&imu_from_camera()));
    let scaled = openvins_imu().replacen("[ 1.0, 0.0, 0.0 ]", "[ 1.01, 0.0, 0.0 ]", 1);
    let unknown = kimera_camera("left_cam", &imu_from_camera()).replace("pinhole", "mei");
    for (files, path, words) in [
        (
            vec![("chain.yaml", chain), ("imu.yaml", scaled)],
            "chain.yaml",
            ["imu.yaml", "Tw is not the identity"],
        ),
        (
            vec![("Left.yaml", unknown), ("ImuParams.yaml", kimera_imu())],
            "Left.yaml",
            ["Left.yaml", "\"mei\""],
        ),
        (
            vec![("euroc.json", "{\"value0\": {\"T_imu_cam\": [{\"px\": 0.1}]}}".to_owned())],
            "euroc.json",
            ["not a valid calibration of Basalt", "missing field"],
        ),
        (
            vec![("EuRoC.yaml", "%YAML:1.0\nCamera.type: \"PinHole\"\nCamera.fx: 435.2\n".to_owned())],
            "EuRoC.yaml",
            ["settings of ORB-SLAM3", "camchain-imucam.yaml"],
        ),
        (
            vec![("vins.yaml", "%YAML:1.0\nimu: 1\nnum_of_cam: 2\nimu_topic: \"/imu0\"\n".to_owned())],
            "vins.yaml",
            ["VINS-Mono or VINS-Fusion", "T_cam_imu"],
        ),
    ] {
        let error = read(&files, path).unwrap_err().to_string();
        assert!(words.iter().all(|word| error.contains(word)), "{error}");
    }
}

#[test]
fn of_several_files_of_an_imu_a_given_one_is_taken() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path
    };
    let chain = file("chain.yaml", &format!("cam0:\n  T_imu_cam: {:?}\n{LENS}", rows(&imu_from_camera())));
    file("a.yaml", &openvins_imu());
    let other = file("b.yaml", &openvins_imu().replace("200.0", "400.0"));
    let error = read_rig_calibration(&chain, None, &[], &[]).unwrap_err().to_string();
    assert!(error.contains("--imu-calibration FILE"), "{error}");
    assert!(crate::states_intrinsics(&chain).unwrap());
    let read = read_rig_calibration(&chain, Some(&other), &[], &[]).unwrap();
    assert!((read.sensors.imu.unwrap().rate_hz - 400.0).abs() < 1e-9);
}
