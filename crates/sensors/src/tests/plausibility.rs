//! Data that contradict the calibration are refused when the recording is opened.

use super::*;
use vision::GrayImage;

#[test]
fn images_of_another_size_than_calibrated_are_refused() {
    let written = sequence(2);
    let folder = tempfile::tempdir().unwrap();
    writer::write(&written, folder.path()).unwrap();
    let fill = |camera: usize, width: usize, height: usize| {
        let data = folder.path().join(format!("mav0/cam{camera}/data"));
        std::fs::create_dir_all(&data).unwrap();
        for frame in &written.frames {
            let image = GrayImage::from_fn(width, height, |x, y| (x + y) as u8);
            image.write(&data.join(format!("{}.png", frame.stamp_ns))).unwrap();
        }
    };
    fill(0, 752, 480);
    fill(1, 752, 480);
    assert!(Recording::open(folder.path()).is_ok() && Sequence::open(folder.path()).is_ok());
    fill(1, 640, 400);
    for error in [
        Recording::open(folder.path()).map(drop).unwrap_err(),
        Sequence::open(folder.path()).map(drop).unwrap_err(),
        Sequence::open_without_readings(folder.path(), &CalibrationFiles::default()).map(drop).unwrap_err(),
    ] {
        let text = error.to_string();
        assert!(matches!(error, SequenceError::ImageSize { camera: 1, .. }), "{text}");
        for word in ["cam1/data", "640 x 400", "752 x 480", "calibration"] {
            assert!(text.contains(word), "{text}");
        }
    }
}

#[test]
fn an_accelerometer_in_g_is_refused_with_the_file_or_read_as_what_it_is_said_to_be() {
    let mut written = sequence(1);
    let at_rest = |index: i64| ImuSample {
        stamp_ns: START_NS + index * 5_000_000,
        gyroscope: Vector3::new(0.01, -0.02, 0.03),
        accelerometer: Vector3::new(0.1, -0.3, 0.95),
    };
    written.imu_samples = (0..1000).map(at_rest).collect();
    let folder = tempfile::tempdir().unwrap();
    writer::write(&written, folder.path()).unwrap();
    for error in [
        Recording::open(folder.path()).map(drop).unwrap_err().to_string(),
        Sequence::open(folder.path()).map(drop).unwrap_err().to_string(),
    ] {
        assert!(error.contains("imu0/data.csv") && error.contains("--accelerometer-unit g"), "{error}");
    }
    let mut files = CalibrationFiles::default();
    files.imu_units.accelerations_in_g = true;
    let read = Sequence::open_with(folder.path(), &files).unwrap();
    assert!((read.imu_samples[3].accelerometer.z - 0.95 * 9.80665).abs() < 1e-9);
}

#[test]
fn readings_are_checked_and_not_kept_where_they_are_not_wanted() {
    let written = sequence(2);
    let folder = tempfile::tempdir().unwrap();
    writer::write(&written, folder.path()).unwrap();
    let files = CalibrationFiles::default();
    let read = Sequence::open_without_readings(folder.path(), &files).unwrap();
    assert!(read.imu_samples.is_empty() && read.frames == written.frames && read.imu == written.imu);
    let path = folder.path().join("mav0/imu0/data.csv");
    let text = std::fs::read_to_string(&path).unwrap();
    let stamp = written.imu_samples[4].stamp_ns.to_string();
    std::fs::write(&path, text.replacen(&stamp, "soon", 1)).unwrap();
    let error = Sequence::open_without_readings(folder.path(), &files).unwrap_err().to_string();
    assert!(error.contains("line 6") && error.contains("\"soon\""), "{error}");
}
