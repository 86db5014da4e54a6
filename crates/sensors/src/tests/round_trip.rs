//! Reading gives back what was written.

use super::*;

fn assert_pose_close(a: &Pose, b: &Pose) {
    assert_eq!(a.translation, b.translation);
    assert!(a.rotation.angle_to(&b.rotation) < 1e-7, "{a:?} {b:?}");
    assert!(
        (a.rotation.coords - b.rotation.coords).amax().min((a.rotation.coords + b.rotation.coords).amax())
            < 1e-14
    );
}

#[test]
fn reading_undoes_writing() {
    for seed in 0..8 {
        let written = sequence(seed);
        let folder = tempfile::tempdir().unwrap();
        writer::write(&written, folder.path()).unwrap();
        let read = Sequence::open(folder.path()).unwrap();
        assert_eq!(read.imu, written.imu);
        assert_eq!(read.imu_samples, written.imu_samples);
        assert_eq!(read.frames, written.frames);
        assert_eq!(read.gnss, written.gnss);
        assert_eq!(read.gnss_readings, written.gnss_readings);
        assert_eq!(read.wheel_readings, written.wheel_readings);
        assert_eq!(read.wheels.is_some(), written.wheels.is_some());
        for (a, b) in read.wheels.iter().zip(&written.wheels) {
            assert_pose_close(&a.imu_from_base, &b.imu_from_base);
            assert_eq!(WheelSensor { imu_from_base: b.imu_from_base, ..*a }, *b);
        }
        assert_eq!(read.cameras.len(), written.cameras.len());
        for (a, b) in read.cameras.iter().zip(&written.cameras) {
            assert_eq!((&a.camera, a.rate_hz, a.readout_s), (&b.camera, b.rate_hz, b.readout_s));
            assert_pose_close(&a.imu_from_camera, &b.imu_from_camera);
        }
        for (a, b) in read.groundtruth.unwrap().iter().zip(written.groundtruth.as_ref().unwrap()) {
            assert_pose_close(&a.pose, &b.pose);
            assert_eq!(TruthRow { pose: b.pose, ..*a }, *b);
        }
        for (a, b) in read.reference_poses.unwrap().iter().zip(written.reference_poses.as_ref().unwrap()) {
            assert_pose_close(&a.pose, &b.pose);
            assert_eq!(ReferencePose { pose: b.pose, ..*a }, *b);
        }
    }
}

#[test]
fn cameras_of_a_rig_that_are_triggered_apart_give_frames_of_their_own() {
    let folder = tempfile::tempdir().unwrap();
    let mut rig = sequence(2);
    rig.cameras.extend(rig.cameras.clone());
    rig.frames.iter_mut().for_each(|frame| {
        frame.tracks.clear();
        frame.features.clear();
    });
    writer::write(&rig, folder.path()).unwrap();
    // The cameras look in different directions; the third one is triggered 30 ms after the others, and the last image of the
    // fourth is lost.
    let path = |camera: usize, file: &str| folder.path().join(format!("mav0/cam{camera}/{file}"));
    for camera in 0..4 {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), camera as f64 * 1.57);
        let mut sensor = rig.cameras[0].clone();
        sensor.camera.distortion = Distortion::None;
        sensor.imu_from_camera = Pose::new(turn, Vector3::zeros());
        let alone = folder.path().join(format!("alone{camera}"));
        let calibration = SensorCalibration { imu: None, cameras: vec![sensor], wheels: None, gnss: None };
        writer::write_calibration(&calibration, &alone).unwrap();
        std::fs::copy(alone.join("mav0/cam0/sensor.yaml"), path(camera, "sensor.yaml")).unwrap();
    }
    let row = |stamp_ns: i64| format!("{stamp_ns},{stamp_ns}.png\n");
    let list = |stamps: &[i64]| stamps.iter().map(|ms| row(ms * 1_000_000)).collect::<String>();
    for (camera, stamps) in [(0, [100, 200, 300]), (1, [101, 200, 299]), (2, [130, 230, 330])] {
        std::fs::write(path(camera, "data.csv"), list(&stamps)).unwrap();
    }
    std::fs::write(path(3, "data.csv"), list(&[100, 200])).unwrap();
    std::fs::write(path(3, "tracks.csv"), "200000000,7,10,20\n").unwrap();
    for camera in 0..4 {
        std::fs::create_dir(path(camera, "data")).unwrap();
        for line in std::fs::read_to_string(path(camera, "data.csv")).unwrap().lines() {
            let name = line.split(',').nth(1).unwrap();
            std::fs::write(path(camera, "data").join(name), "an image").unwrap();
        }
    }
    let (stored, calibration) = crate::stored::open(folder.path(), &CalibrationFiles::default()).unwrap();
    assert_eq!((calibration.cameras.len(), stored.stereo_pairs()), (4, None));
    let frames: Vec<Frame> = stored.frames().unwrap().map(Result::unwrap).collect();
    let seen: Vec<(i64, Vec<usize>)> = frames
        .iter()
        .map(|frame| (frame.stamp_ns / 1_000_000, frame.images.keys().copied().collect()))
        .collect();
    let expected = [
        (100, vec![0, 1, 3]),
        (130, vec![2]),
        (200, vec![0, 1, 3]),
        (230, vec![2]),
        (300, vec![0, 1]),
        (330, vec![2]),
    ];
    assert_eq!(seen, expected);
    let tracks: Vec<u8> = frames[2].tracks.iter().map(|track| track.camera).collect();
    assert_eq!(tracks, [3]);
}

#[test]
fn writing_what_was_read_gives_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let (first, second) = (folder.path().join("first"), folder.path().join("second"));
    writer::write(&sequence(2), &first).unwrap();
    writer::write(&Sequence::open(&first).unwrap(), &second).unwrap();
    for file in [
        "mav0/imu0/data.csv",
        "mav0/cam1/tracks.csv",
        "mav0/cam0/features.csv",
        "mav0/cam1/features.csv",
        "mav0/imu0/sensor.yaml",
    ] {
        assert_eq!(
            std::fs::read(first.join(file)).unwrap(),
            std::fs::read(second.join(file)).unwrap(),
            "{file}"
        );
    }
}

#[test]
fn a_recording_for_mapping_needs_neither_imu_nor_tracks_nor_truth() {
    let mut written = sequence(1);
    written.imu = None;
    written.imu_samples.clear();
    written.groundtruth = None;
    written.frames.iter_mut().for_each(|frame| frame.tracks.clear());
    let folder = tempfile::tempdir().unwrap();
    writer::write(&written, folder.path()).unwrap();
    let read = Sequence::open(folder.path()).unwrap();
    assert!(read.imu.is_none() && read.groundtruth.is_none() && read.truth_gravity().is_none());
    assert_eq!(read.frames, written.frames);
    assert_eq!(read.reference_poses.unwrap().len(), 5);
}

#[test]
fn euroc_files_as_published_are_read() {
    let folder = tempfile::tempdir().unwrap();
    writer::write(&sequence(1), folder.path()).unwrap();
    let yaml = "%YAML:1.0\n#Default imu sensor yaml file\nsensor_type: imu\ncomment: VI-Sensor IMU (ADIS16448)\n\n\
        # Sensor extrinsics wrt. the body-frame.\nT_BS:\n  cols: 4\n  rows: 4\n  data: [1.0, 0.0, 0.0, 0.0,\n\
        \t 0.0, 1.0, 0.0, 0.0,\n         0.0, 0.0, 1.0, 0.0,\n         0.0, 0.0, 0.0, 1.0]\nrate_hz: 200\n\n\
        gyroscope_noise_density: 1.6968e-04     # [ rad / s / sqrt(Hz) ]\n\
        gyroscope_random_walk: 1.9393e-05\t# [ rad / s^2 / sqrt(Hz) ]\n\
        accelerometer_noise_density: 2.0000e-3\naccelerometer_random_walk: 3.0000e-3\n";
    std::fs::write(folder.path().join("mav0/imu0/sensor.yaml"), yaml).unwrap();
    let windows = "#timestamp [ns],w_RS_S_x [rad s^-1]\r\n10,1,2,3,4,5,6\r\n20, 1, 2, 3, 4, 5, 6\r\n";
    std::fs::write(folder.path().join("mav0/imu0/data.csv"), windows).unwrap();
    let read = Sequence::open(folder.path()).unwrap();
    assert_eq!(read.imu.unwrap().noise, ImuNoise::default());
    assert_eq!(read.imu_samples.len(), 2);
    assert_eq!(read.imu_samples[1].accelerometer, Vector3::new(4.0, 5.0, 6.0));
}

#[test]
fn a_header_without_a_hash_is_a_header() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("truth.csv");
    std::fs::write(&path, "timestamp,x,y,z,w,x,y,z\n5,1,2,3,1,0,0,0\n").unwrap();
    let rows = read_groundtruth(&path).unwrap();
    assert_eq!((rows.len(), rows[0].velocity), (1, None));
}
