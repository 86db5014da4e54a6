//! Poses to build a map from that the recording contradicts.

use crate::common::scenario::options;
use geometry::Pose;
use mapping::{BuildError, BuildOptions, build_map};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use sensors::ReferencePose;
use simulation::simulate;

#[test]
fn poses_that_turn_otherwise_than_the_gyroscope_are_refused_and_others_are_not() {
    let recording = simulate(&options(7)).unwrap().map;
    let good = recording.reference_poses.clone().unwrap();
    let build = |references: &[ReferencePose]| {
        build_map(&recording, references, None, &BuildOptions::default(), &mut |_, _, _| {})
    };
    let changed = |change: &dyn Fn(&Pose) -> Pose| -> Vec<ReferencePose> {
        good.iter().map(|known| ReferencePose { pose: change(&known.pose), ..*known }).collect()
    };
    // The quaternion's w is written last, and read as if it were first.
    let reordered = changed(&|pose| {
        let q = pose.rotation.quaternion();
        let rotation = UnitQuaternion::new_normalize(Quaternion::new(q.i, q.j, q.k, q.w));
        Pose::new(rotation, pose.translation)
    });
    // Poses of the camera, as SLAM programs write them.
    let imu_from_camera = recording.cameras[0].imu_from_camera;
    let of_camera = changed(&|pose| pose.compose(&imu_from_camera));
    for (name, poses) in [("w last", &reordered), ("of the camera", &of_camera)] {
        let error = build(poses).map(|(_, report)| report.pose_correction_deg).unwrap_err();
        assert!(matches!(error, BuildError::ReferencesTurnOtherwise { .. }), "{name}: {error}");
        println!("{name}: {error}");
    }
    // Another frame, a common shift: the gyroscope does not know of it.
    let global_from_truth =
        Pose::new(UnitQuaternion::from_scaled_axis(Vector3::z() * 1.2), Vector3::new(30.0, -12.0, 4.0));
    assert!(build(&changed(&|pose| global_from_truth.compose(pose))).is_ok());
}
