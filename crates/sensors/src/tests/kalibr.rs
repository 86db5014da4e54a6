//! Calibrations of Kalibr take the place of `sensor.yaml`.

use super::*;
use nalgebra::Matrix4;

const SHIFT_NS: i64 = -7_312_345;

fn rows(pose: &Pose) -> String {
    let mut matrix = Matrix4::identity();
    matrix.fixed_view_mut::<3, 3>(0, 0).copy_from(pose.rotation.to_rotation_matrix().matrix());
    matrix.fixed_view_mut::<3, 1>(0, 3).copy_from(&pose.translation);
    let line = |row: usize| {
        let cells = [0, 1, 2, 3].map(|column| matrix[(row, column)].to_string());
        format!("  - [{}]\n", cells.join(", "))
    };
    [0, 1, 2, 3].map(line).concat()
}

/// The camera chain of a recording, as kalibr_calibrate_imu_camera writes it. With `chained` the second camera is given
/// with respect to the first.
fn chain(sequence: &Sequence, chained: bool) -> String {
    let mut text = Vec::new();
    for (index, sensor) in sequence.cameras.iter().enumerate() {
        let camera = &sensor.camera;
        let pinhole = [camera.focal, camera.centre].concat();
        let (camera_model, before, model, coefficients) = match camera.distortion {
            Distortion::RadialTangential(_) | Distortion::Rational(_) => {
                ("pinhole", vec![], "radtan", camera.distortion.coefficients())
            }
            Distortion::DoubleSphere { xi, alpha } => ("ds", vec![xi, alpha], "none", vec![]),
            Distortion::Eucm { alpha, beta } => ("eucm", vec![alpha, beta], "none", vec![]),
            Distortion::Omni { xi, distortion } => ("omni", vec![xi], "radtan", distortion.to_vec()),
            other => ("pinhole", vec![], other.name(), other.coefficients()),
        };
        let intrinsics = [before, pinhole].concat();
        let camera_from_imu = sensor.imu_from_camera.inverse();
        text.push(format!("cam{index}:\n  cam_overlaps: [{}]\n", 1 - index));
        if index == 0 || !chained {
            text.push(format!("  T_cam_imu:\n{}", rows(&camera_from_imu)));
        }
        if index == 1 {
            let first_from_imu = sequence.cameras[0].imu_from_camera.inverse();
            text.push(format!("  T_cn_cnm1:\n{}", rows(&(camera_from_imu * first_from_imu.inverse()))));
        }
        text.push(format!(
            "  camera_model: {camera_model}\n  distortion_coeffs: {coefficients:?}\n  distortion_model: {model}\n  \
             intrinsics: {intrinsics:?}\n  resolution: [{}, {}]\n  rostopic: /cam{index}/image_raw\n  \
             timeshift_cam_imu: {}\n  line_delay: {}\n",
            camera.width,
            camera.height,
            SHIFT_NS as f64 * 1e-9,
            sensor.readout_s / f64::from(camera.height)
        ));
    }
    text.concat()
}

/// As it goes into Kalibr.
const IMU: &str = "#Accelerometers\naccelerometer_noise_density: 2.0e-03   #Noise density\naccelerometer_random_walk: \
                   3.0e-03\n#Gyroscopes\ngyroscope_noise_density: 1.6968e-04\ngyroscope_random_walk: 1.9393e-05\n\
                   rostopic: /imu0\nupdate_rate: 200\n";

/// As it comes out of Kalibr.
const RESULT: &str = "imu0:\n  T_i_b:\n  - [1.0, 0.0, 0.0, 0.0]\n  - [0.0, 1.0, 0.0, 0.0]\n  - [0.0, 0.0, 1.0, 0.0]\n  \
                      - [0.0, 0.0, 0.0, 1.0]\n  accelerometer_noise_density: 0.002\n  accelerometer_random_walk: 0.003\n  \
                      gyroscope_noise_density: 0.00016968\n  gyroscope_random_walk: 1.9393e-05\n  model: calibrated\n  \
                      rostopic: /imu0\n  time_offset: 0.0\n  update_rate: 200.0\n";

/// What Kalibr writes of scale and misalignment, row by row.
const SCALE: [[f64; 9]; 4] = [
    [1.02, 0.0, 0.0, 0.01, 0.98, 0.0, -0.02, 0.004, 1.01],
    [0.97, 0.0, 0.0, -0.005, 1.03, 0.0, 0.006, 0.01, 0.99],
    [1.0, 0.0, 0.0, 0.0, 0.8, -0.6, 0.0, 0.6, 0.8],
    [1e-3, -2e-4, 3e-4, 5e-4, 2e-3, 0.0, -1e-4, 4e-4, -6e-4],
];

/// The result of Kalibr with a model that has scale and misalignment.
fn scaled(model: &str) -> String {
    let rows = |matrix: [f64; 9]| {
        let row = |from: usize| format!("{:?}", &matrix[from..from + 3]);
        format!("[{}, {}, {}]", row(0), row(3), row(6))
    };
    let [accelerometer, gyroscope, rotation, g_sensitivity] = SCALE.map(rows);
    let size = if model.ends_with("effect") {
        "    rx_i: [0.0, 0.0, 0.0]\n    ry_i: [0.002, 0.0, 0.0]\n    rz_i: [0.0, 0.001, 0.001]\n"
    } else {
        ""
    };
    let result = RESULT.replace("model: calibrated", &format!("model: {model}"));
    format!(
        "{result}  accelerometers:\n    M: {accelerometer}\n{size}  gyroscopes:\n    M: {gyroscope}\n    A: {g_sensitivity}\n    \
         C_gyro_i: {rotation}\n"
    )
}

/// What an IMU with this scale and misalignment reads of a motion.
fn distorted(motion: &ImuSample) -> ImuSample {
    let [accelerometer, gyroscope, rotation, g_sensitivity] =
        SCALE.map(|matrix| nalgebra::Matrix3::from_row_slice(&matrix));
    ImuSample {
        stamp_ns: motion.stamp_ns,
        gyroscope: gyroscope * rotation * motion.gyroscope + g_sensitivity * rotation * motion.accelerometer,
        accelerometer: accelerometer * motion.accelerometer,
    }
}

#[test]
fn scale_and_misalignment_are_taken_from_the_readings() {
    let written = sequence(2);
    let mut recorded = written.clone();
    recorded.imu_samples = written.imu_samples.iter().map(distorted).collect();
    let folder = without_calibration(&recorded);
    std::fs::write(folder.path().join("camchain.yaml"), chain(&written, false)).unwrap();
    for model in ["scale-misalignment", "scale-misalignment-size-effect"] {
        std::fs::write(folder.path().join("imu.yaml"), scaled(model)).unwrap();
        let read = Sequence::open(folder.path()).unwrap();
        assert_eq!(read.imu_samples.len(), written.imu_samples.len());
        for (a, b) in read.imu_samples.iter().zip(&written.imu_samples) {
            assert_eq!(a.stamp_ns, b.stamp_ns);
            assert!((a.gyroscope - b.gyroscope).norm() < 1e-12, "{model}");
            assert!((a.accelerometer - b.accelerometer).norm() < 1e-12, "{model}");
        }
    }
    std::fs::write(folder.path().join("imu.yaml"), RESULT).unwrap();
    let read = Sequence::open(folder.path()).unwrap();
    assert!((read.imu_samples[0].gyroscope - written.imu_samples[0].gyroscope).norm() > 1e-3);
}

/// A recording on disk without `sensor.yaml` files.
fn without_calibration(sequence: &Sequence) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    writer::write(sequence, folder.path()).unwrap();
    for sensor in ["imu0", "cam0", "cam1"] {
        std::fs::remove_file(folder.path().join(format!("mav0/{sensor}/sensor.yaml"))).unwrap();
    }
    folder
}

/// Directions and offset are those of Kalibr: `p_cam = T_cam_imu p_imu`, `t_imu = t_cam + timeshift_cam_imu`.
fn assert_read(read: &Sequence, written: &Sequence) {
    let imu = read.imu.as_ref().unwrap();
    assert_eq!((imu.noise, imu.rate_hz), (ImuNoise::default(), 200.0));
    for (a, b) in read.cameras.iter().zip(&written.cameras) {
        assert_eq!(a.camera, b.camera);
        assert!((a.readout_s - b.readout_s).abs() < 1e-12);
        assert!(a.imu_from_camera.local(&b.imu_from_camera).amax() < 1e-7);
        assert!((a.rate_hz - 10.0).abs() < 1e-3);
    }
    for (a, b) in read.frames.iter().zip(&written.frames) {
        assert_eq!(a.stamp_ns, b.stamp_ns + SHIFT_NS);
        assert_eq!((&a.tracks, &a.features), (&b.tracks, &b.features));
    }
}

#[test]
fn files_in_the_folder_are_found_by_their_content() {
    for seed in [0, 2, 4, 6] {
        let written = sequence(seed);
        let folder = without_calibration(&written);
        for (place, imu, chained) in [("", IMU, false), ("mav0", RESULT, true), ("dso", IMU, true)] {
            let place = folder.path().join(place);
            std::fs::create_dir_all(&place).unwrap();
            let files = [place.join("my-camchain.yaml"), place.join("adis.yaml")];
            std::fs::write(&files[0], chain(&written, chained)).unwrap();
            std::fs::write(&files[1], imu).unwrap();
            assert_read(&Sequence::open(folder.path()).unwrap(), &written);
            assert_eq!(Recording::open(folder.path()).unwrap().calibration().cameras.len(), 2);
            let used = FolderCalibration::read(folder.path(), &CalibrationFiles::default()).unwrap();
            assert_eq!((used.time_offset_ns, used.files.cameras.as_deref()), (SHIFT_NS, Some(&*files[0])));
            for file in files {
                std::fs::remove_file(file).unwrap();
            }
        }
    }
}

#[test]
fn cameras_have_time_shifts_of_their_own() {
    let written = sequence(2);
    let folder = without_calibration(&written);
    std::fs::write(folder.path().join("imu.yaml"), IMU).unwrap();
    let list = folder.path().join("mav0/cam1/data.csv");
    let stamped = std::fs::read_to_string(&list).unwrap();
    // The stamps of the second camera are late by what Kalibr finds; a delay of the exposure is in none.
    for (late_ns, delay_ns) in [(0, 0), (0, 2_000_000), (30_000_000, 0), (-8_000_000, 0)] {
        let shift_ns = SHIFT_NS - late_ns + delay_ns;
        let text = chain(&written, false);
        let (first, second) = text.split_at(text.find("cam1:").unwrap());
        let own = format!("timeshift_cam_imu: {}", SHIFT_NS as f64 * 1e-9);
        assert!(second.contains(&own));
        let second = second.replace(&own, &format!("timeshift_cam_imu: {}", shift_ns as f64 * 1e-9));
        std::fs::write(folder.path().join("camchain.yaml"), format!("{first}{second}")).unwrap();
        let restamped = |line: &str| match line.split_once(',') {
            Some((stamp, rest)) if !line.starts_with('#') => {
                format!("{},{rest}\n", stamp.parse::<i64>().unwrap() + late_ns)
            }
            _ => format!("{line}\n"),
        };
        std::fs::write(&list, stamped.lines().map(restamped).collect::<String>()).unwrap();
        for tables in ["tracks.csv", "features.csv"] {
            let _ = std::fs::remove_file(folder.path().join("mav0/cam1").join(tables));
        }
        let read = Sequence::open(folder.path()).unwrap();
        assert!((read.cameras[1].delay_s() - delay_ns as f64 * 1e-9).abs() < 1e-12);
        assert_eq!(read.frames.len(), written.frames.len(), "{late_ns} ns late: the images are joined");
        for (a, b) in read.frames.iter().zip(&written.frames) {
            assert_eq!(a.stamp_ns, b.stamp_ns + SHIFT_NS);
        }
        // What is written has the stamps of the frames, and states the delay.
        let copy = tempfile::tempdir().unwrap();
        writer::write(&read, copy.path()).unwrap();
        let again = Sequence::open(copy.path()).unwrap();
        assert!((again.cameras[1].delay_s() - read.cameras[1].delay_s()).abs() < 1e-15);
        let stamps = |of: &Sequence| of.frames.iter().map(|frame| frame.stamp_ns).collect::<Vec<_>>();
        assert_eq!(stamps(&again), stamps(&read));
    }
}

#[test]
fn named_files_come_before_sensor_yaml_and_found_files_after_it() {
    let written = sequence(2);
    let (folder, elsewhere) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    writer::write(&written, folder.path()).unwrap();
    let file = |name| Some(elsewhere.path().join(name));
    let files =
        CalibrationFiles { cameras: file("c.yaml"), imu: file("i.yaml"), ..CalibrationFiles::default() };
    std::fs::write(files.cameras.as_ref().unwrap(), chain(&written, false)).unwrap();
    std::fs::write(files.imu.as_ref().unwrap(), IMU).unwrap();
    let (read, time_offset_ns) = Sequence::open_with_offset(folder.path(), &files).unwrap();
    assert_read(&read, &written);
    assert_eq!(time_offset_ns, SHIFT_NS);
    std::fs::copy(files.cameras.as_ref().unwrap(), folder.path().join("camchain.yaml")).unwrap();
    assert_eq!(Sequence::open(folder.path()).unwrap().frames[0].stamp_ns, written.frames[0].stamp_ns);
    assert_eq!(calibration::read_lens(files.cameras.as_ref().unwrap()).unwrap(), written.cameras[0].camera);
}

#[test]
fn what_cannot_be_used_is_named_with_what_can() {
    let written = sequence(2);
    let folder = without_calibration(&written);
    let (chain_path, imu_path) = (folder.path().join("camchain-imucam.yaml"), folder.path().join("imu.yaml"));
    let error = |chain: String, imu: &str| {
        std::fs::write(&chain_path, chain).unwrap();
        std::fs::write(&imu_path, imu).unwrap();
        Sequence::open(folder.path()).unwrap_err().to_string()
    };
    let good = chain(&written, false);
    let only_first = good[..good.find("cam1:").unwrap()].to_owned();
    for (text, word) in [
        (good.replacen("pinhole", "mei", 1), "\"mei\" is unknown: use pinhole"),
        (good.replacen("distortion_model: ", "distortion_model: mei", 1), "fov or thin-prism-fisheye"),
        (good.replacen("T_cam_imu", "T_other", 1), "kalibr_calibrate_imu_camera"),
        (good.replacen("intrinsics: [", "intrinsics: [1.0, ", 1), "fu, fv, cu, cv"),
        (good.replacen("timeshift_cam_imu: ", "timeshift_cam_imu: 1e4 # ", 1), "in seconds"),
        (good.replacen("line_delay: ", "line_delay: 30.5 # ", 1), "line_delay of cam0"),
        (only_first, "has no cam1"),
    ] {
        let error = error(text, IMU);
        assert!(error.contains("camchain-imucam.yaml") && error.contains(word), "{error}");
    }
    for (imu, word) in [
        (RESULT.replace("calibrated", "scale-misalignment"), "accelerometers (M)"),
        (RESULT.replace("calibrated", "bent"), "\"bent\" is unknown"),
        (scaled("scale-misalignment").replace("1.02", "9.81"), "no scale"),
        (
            scaled("scale-misalignment").replace("C_gyro_i: [[1.0", "C_gyro_i: [[1.2"),
            "C_gyro_i: it is not a rotation",
        ),
        (scaled("scale-misalignment-size-effect").replace("0.002", "0.03"), "beyond 1 cm"),
        (IMU.replace("1.6968e-04", "-1"), "gyroscope_noise_density"),
        (RESULT.replace("- [1.0, 0.0, 0.0, 0.0]", "- [1.0, 0.0, 0.0, 0.3]"), "T_i_b"),
    ] {
        let error = error(good.clone(), &imu);
        assert!(error.contains("imu.yaml") && error.contains(word), "{error}");
    }
    std::fs::write(folder.path().join("second.yaml"), &good).unwrap();
    let error = error(good, IMU);
    assert!(error.contains("second.yaml") && error.contains("--calibration"), "{error}");
}
