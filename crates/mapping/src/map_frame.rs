//! Maps in other frames.

use geometry::Pose;
use map::contents::MapContents;
use nalgebra::Matrix6;

/// A map in another frame.
///
/// # Arguments
/// * `to_frame`: from the frame of the map.
pub fn map_in_frame(map: &MapContents, to_frame: &Pose) -> MapContents {
    let mut moved = map.clone();
    let rotation = to_frame.rotation.to_rotation_matrix().into_inner();
    let mut both = Matrix6::zeros();
    both.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
    both.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
    for keyframe in &mut moved.keyframes {
        let stated = &mut keyframe.global_from_keyframe;
        stated.pose = to_frame.compose(&stated.pose);
        stated.covariance = both * stated.covariance * both.transpose();
    }
    for cross in &mut moved.cross_covariances {
        cross.block = both * cross.block * both.transpose();
    }
    for common in &mut moved.common_errors {
        common.factor = both * &common.factor;
    }
    if let Some(gravity) = &mut moved.info.gravity_in_global {
        *gravity = to_frame.rotation * *gravity;
    }
    moved
}
