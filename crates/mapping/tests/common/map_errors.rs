//! Errors of a map without reference poses.

use evaluation::{Alignment, align};
use geometry::Pose;
use map::contents::MapContents;
use map::model::{CommonError, Keyframe};
use nalgebra::{DMatrix, DVector, Matrix6, Matrix6xX, Vector3};
use sensors::Sequence;

/// The true pose of the IMU at a time, in the frame of the ground truth.
pub fn true_pose(sequence: &Sequence, stamp_ns: i64) -> Pose {
    let truth = sequence.groundtruth.as_ref().unwrap();
    let next = truth.partition_point(|row| row.stamp_ns < stamp_ns).clamp(1, truth.len() - 1);
    let (before, after) = (&truth[next - 1], &truth[next]);
    let fraction = (stamp_ns - before.stamp_ns) as f64 / (after.stamp_ns - before.stamp_ns) as f64;
    before.pose.interpolate(&after.pose, fraction)
}

/// Errors that the frame of a map takes away: yaw and position.
pub const FRAME_DIM: usize = 4;

/// From the frame of the ground truth to G, by positions and yaw of all keyframes.
pub fn global_from_truth(sequence: &Sequence, contents: &MapContents) -> Pose {
    let imu_from_camera = sequence.cameras[0].imu_from_camera;
    let truth =
        |keyframe: &Keyframe| true_pose(sequence, keyframe.stamp_ns).compose(&imu_from_camera).translation;
    let positions: Vec<_> = contents
        .keyframes
        .iter()
        .map(|keyframe| (keyframe.global_from_keyframe.pose.translation, truth(keyframe)))
        .collect();
    let gravity = -Vector3::z();
    let yaw = Alignment::Yaw { gravity_in_reference: gravity, gravity_in_estimate: gravity };
    align(&positions, &yaw).unwrap()
}

/// The true pose of the camera at the time of each keyframe, in G as the map defines it.
pub fn true_poses(sequence: &Sequence, contents: &MapContents) -> Vec<Pose> {
    true_poses_in(&global_from_truth(sequence, contents), sequence, contents)
}

/// The true pose of the camera at the time of each keyframe, in a frame that is known.
pub fn true_poses_in(global_from_truth: &Pose, sequence: &Sequence, contents: &MapContents) -> Vec<Pose> {
    let imu_from_camera = sequence.cameras[0].imu_from_camera;
    let camera = |keyframe: &Keyframe| true_pose(sequence, keyframe.stamp_ns).compose(&imu_from_camera);
    contents.keyframes.iter().map(|keyframe| global_from_truth.compose(&camera(keyframe))).collect()
}

/// Errors of all keyframes, and their joint covariance.
pub fn errors(contents: &MapContents, truth: &[Pose]) -> (DVector<f64>, DMatrix<f64>) {
    let count = contents.keyframes.len();
    let mut covariance = DMatrix::zeros(6 * count, 6 * count);
    let mut error = DVector::zeros(6 * count);
    for (index, (keyframe, truth)) in contents.keyframes.iter().zip(truth).enumerate() {
        let pose = &keyframe.global_from_keyframe;
        covariance.fixed_view_mut::<6, 6>(6 * index, 6 * index).copy_from(&pose.covariance);
        error.fixed_rows_mut::<6>(6 * index).copy_from(&pose.pose.local(truth));
    }
    let at = |id: u64| contents.keyframes.iter().position(|keyframe| keyframe.id == id).unwrap();
    for cross in &contents.cross_covariances {
        let (a, b) = (6 * at(cross.a), 6 * at(cross.b));
        covariance.fixed_view_mut::<6, 6>(a, b).copy_from(&cross.block);
        covariance.fixed_view_mut::<6, 6>(b, a).copy_from(&cross.block.transpose());
    }
    (error, covariance)
}

/// The same map with its covariance stated as large maps state it: what all keyframes have in common with one of them as common
/// errors, and what remains by pairs.
pub fn with_common_errors(contents: &MapContents) -> MapContents {
    let mut stated = contents.clone();
    let anchor = &contents.keyframes[contents.keyframes.len() / 2];
    let variance = anchor.global_from_keyframe.covariance;
    let with_anchor = |id: u64| -> Matrix6<f64> {
        let block = |a, b| contents.cross_covariances.iter().find(|cross| (cross.a, cross.b) == (a, b));
        match id.cmp(&anchor.id) {
            std::cmp::Ordering::Equal => variance,
            std::cmp::Ordering::Less => block(id, anchor.id).unwrap().block,
            std::cmp::Ordering::Greater => block(anchor.id, id).unwrap().block.transpose(),
        }
    };
    let root = variance.cholesky().unwrap().l();
    let common = |keyframe: &Keyframe| {
        let factor = root.solve_lower_triangular(&with_anchor(keyframe.id).transpose()).unwrap().transpose();
        CommonError { keyframe: keyframe.id, factor: Matrix6xX::from_column_slice(factor.as_slice()) }
    };
    stated.common_errors = contents.keyframes.iter().map(common).collect();
    let of = |id: u64| stated.common_errors.iter().find(|common| common.keyframe == id).unwrap();
    for cross in &mut stated.cross_covariances {
        cross.block -= of(cross.a).covariance_with(of(cross.b));
    }
    stated.validate().unwrap();
    stated
}
