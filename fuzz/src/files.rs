//! Files that users bring: calibrations and tables.

use evaluation::trajectory::{StateKind, read_any};
use std::path::Path;

/// `sensor.yaml` of a camera.
///
/// # Panics
/// A camera that was read is not valid.
pub fn sensor_yaml(data: &[u8]) {
    in_file("sensor.yaml", data, |path| {
        if let Ok(camera) = calibration::read_lens(path) {
            camera.validate().expect("a camera that was read is valid");
        }
    });
}

/// Trajectories (TUM, EuRoC ground truth, `states.csv`) and reference poses.
///
/// # Panics
/// Rows that were read are not in order of time, or not finite.
pub fn csv_tables(data: &[u8]) {
    in_file("table.csv", data, |path| {
        if let Ok(rows) = sensors::read_groundtruth(path) {
            assert!(rows.windows(2).all(|pair| pair[0].stamp_ns < pair[1].stamp_ns), "rows are in order");
        }
        let _ = sensors::read_reference_poses(path);
        if let Ok(trajectory) = read_any(path, &[StateKind::GlobalFromImu]) {
            assert!(trajectory.poses.iter().all(|pose| pose.pose.translation.iter().all(|x| x.is_finite())));
        }
    });
}

/// Hands the bytes over as a file.
pub(crate) fn in_file(name: &str, data: &[u8], read: impl FnOnce(&Path)) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join(name);
    std::fs::write(&path, data).expect("a temporary file");
    read(&path);
}
