//! Maps of recordings whose poses nobody knows, against the truth.

use super::{assert_consistent, pose_within};
use evaluation::trajectory::StampedPose;
use evaluation::{Alignment, Pair, absolute_errors, align, interpolate_reference};
use geometry::Pose;
use map::MapContents;
use mapping::{BuildOptions, BuildReport, PosePriors, build_map_from_odometry, run_odometry};
use nalgebra::Vector3;
use recognition::LoadedMap;
use sensors::Sequence;
use std::path::Path;
use std::sync::Arc;
use tests::data::recording;
use tests::robot::run_in_map;

/// A map without reference poses, from a folder.
pub(super) fn built_from_odometry(folder: &Path) -> (Sequence, MapContents, BuildReport) {
    let mut sequence = Sequence::open(folder).unwrap();
    let cameras = sequence.cameras.len();
    let odometry = run_odometry(&mut sequence, cameras, |_, _| {}).unwrap();
    let options = BuildOptions::default();
    let (contents, report) = build_map_from_odometry(
        &sequence,
        &odometry,
        &PosePriors::default(),
        None,
        &options,
        &mut |_, _, _| {},
    )
    .unwrap();
    (sequence, contents, report)
}

/// Aligns the truth with a map by yaw and position.
///
/// # Returns
/// `global_from_truth`, and the errors of the keyframes (m, deg).
pub(super) fn errors_of(sequence: &Sequence, contents: &MapContents) -> (Pose, f64, f64) {
    let truth: Vec<StampedPose> = sequence
        .groundtruth
        .iter()
        .flatten()
        .map(|row| StampedPose { stamp_ns: row.stamp_ns, pose: row.pose })
        .collect();
    let camera_from_imu = sequence.cameras[0].imu_from_camera.inverse();
    let of_imu = |keyframe: &map::Keyframe| StampedPose {
        stamp_ns: keyframe.stamp_ns,
        pose: keyframe.global_from_keyframe.pose.compose(&camera_from_imu),
    };
    let estimate: Vec<StampedPose> = contents.keyframes.iter().map(of_imu).collect();
    let (truth, pairs) = interpolate_reference(&truth, &estimate, 60_000_000);
    assert!(pairs.len() + 5 > estimate.len(), "{} of {} keyframes", pairs.len(), estimate.len());
    let positions: Vec<_> = pairs
        .iter()
        .map(|pair| (estimate[pair.estimate].pose.translation, truth[pair.reference].pose.translation))
        .collect();
    let gravity = -Vector3::z();
    let yaw = Alignment::Yaw { gravity_in_reference: gravity, gravity_in_estimate: gravity };
    // The truth is moved into the map.
    let global_from_truth = align(&positions, &yaw).unwrap();
    let errors = absolute_errors(&estimate, &truth, &swapped(&pairs), &global_from_truth);
    (global_from_truth, errors.translation().unwrap().rmse, errors.rotation().unwrap().rmse)
}

fn swapped(pairs: &[Pair]) -> Vec<Pair> {
    pairs.iter().map(|pair| Pair { reference: pair.estimate, estimate: pair.reference }).collect()
}

#[test]
#[ignore = "needs the recordings in target/data"]
fn a_hall_mapped_without_reference_poses() {
    let (sequence, contents, report) = built_from_odometry(&recording("odometry/MH_01_easy"));
    assert!(report.loops > 100 && report.refused_loops * 20 < report.loops, "{report:?}");
    let (global_from_truth, metres, degrees) = errors_of(&sequence, &contents);
    assert!(metres < 0.006 && degrees < 0.06, "{metres} m, {degrees} deg");

    let map = Arc::new(LoadedMap::from_contents(contents).unwrap());
    let mut live = Sequence::open(&recording("odometry/MH_03_medium")).unwrap();
    for row in live.groundtruth.iter_mut().flatten() {
        row.pose = global_from_truth.compose(&row.pose);
        row.velocity = row.velocity.map(|velocity| global_from_truth.rotation * velocity);
    }
    let out = tempfile::tempdir().unwrap();
    let outcome = run_in_map(&live, out.path(), "--init truth --mode multi", &map);
    assert_consistent(&pose_within(&outcome, 0.02, 0.15));
}
