//! Loops: places that are seen again, found by recognition and judged by the trajectory.

use std::collections::{BTreeMap, BTreeSet};

use adjustment::{POSE, RelativePose, StateCovariance, parallel};
use geometry::pose::Pose;
use map::contents::MapContents;
use nalgebra::{Matrix3, Matrix6, SMatrix, Vector3};
use recognition::{LoadedMap, RecognitionOptions, VerifiedPlace};

use super::assemble::keyframe_id;
use super::camera::Rig;
use super::error::BuildError;
use super::keyframe_view::KeyframeView;
use super::progress::{Progress, Stage};

/// Loops of one image that are kept: those with the most matches.
const LOOPS_AN_IMAGE: usize = 2;
/// Least standard deviations of a loop (rad, m): landmarks of a map under construction are not exact.
const MIN_SIGMAS: [f64; 2] = [0.01, 0.05];
/// The standard deviations of a trajectory without loops are taken for so many times as large: those that calibration files
/// state of an IMU are too small by this factor on real recordings.
const TRAJECTORY_FACTOR: f64 = 3.0;
/// A loop is refused when its squared distance from the adjusted trajectory exceeds this: chi-square with 6 degrees of
/// freedom, 0.1 %.
const GATE: f64 = 22.5;

/// Finds views that show a place that a much earlier view shows.
///
/// # Arguments
/// * `contents`: the map so far.
/// * `least_gap`: views closer to each other in the sequence are neighbours and no loop.
///
/// # Errors
/// [`BuildError::Index`], [`BuildError::Recognition`].
pub(super) fn find_loops(
    contents: MapContents,
    rig: &Rig,
    views: &[KeyframeView<'_>],
    poses: &[Pose],
    least_gap: usize,
    progress: Progress<'_>,
) -> Result<Vec<RelativePose>, BuildError> {
    let gravity_in_global = contents.info.gravity_in_global;
    let map = LoadedMap::from_contents(contents)?;
    let mut view_of: BTreeMap<u64, usize> = BTreeMap::new();
    for (view, content) in views.iter().enumerate() {
        view_of.extend(content.images.iter().map(|image| (keyframe_id(rig, view, image.group), view)));
    }
    let options = RecognitionOptions::default();
    let of_view = |view: usize| -> Result<Vec<RelativePose>, BuildError> {
        let content = &views[view];
        if !content.is_keyframe() || view < least_gap {
            return Ok(Vec::new());
        }
        let eligible =
            |keyframe: u64| view_of.get(&keyframe).is_some_and(|earlier| earlier + least_gap <= view);
        let mut loops = Vec::new();
        for image in &content.images {
            let camera_pose = rig.camera_pose(image.group, &poses[view]);
            let gravity_in_camera = gravity_in_global.map(|down| camera_pose.rotation.inverse() * down);
            let camera = rig.camera(image.group);
            let places =
                map.verified_places(camera, &image.features, gravity_in_camera, &eligible, &options)?;
            let relative = |place: &VerifiedPlace| {
                let earlier = view_of[&place.keyframe];
                let first = &poses[earlier];
                let global_from_view = rig.body_pose(image.group, &place.global_from_camera);
                RelativePose {
                    views: [earlier, view],
                    first_from_second: first.inverse().compose(&global_from_view.pose),
                    information: information(first, &global_from_view.covariance),
                }
            };
            loops.extend(places.iter().take(LOOPS_AN_IMAGE).map(relative));
        }
        Ok(loops)
    };
    let show = |done| progress(Stage::PlaceRecognition, done, views.len());
    let mut loops = Vec::new();
    for of_view in parallel::map(views.len(), of_view, show) {
        loops.extend(of_view?);
    }
    Ok(loops)
}

/// Inverse covariance in the frame of the earlier view, from the covariance in G.
pub(super) fn information(earlier: &Pose, covariance: &Matrix6<f64>) -> Matrix6<f64> {
    let to_view = earlier.rotation.inverse().to_rotation_matrix().into_inner();
    let mut both = Matrix6::zeros();
    both.fixed_view_mut::<3, 3>(0, 0).copy_from(&to_view);
    both.fixed_view_mut::<3, 3>(3, 3).copy_from(&to_view);
    let mut in_view = both * covariance * both.transpose();
    for (begin, sigma) in [(0, MIN_SIGMAS[0]), (3, MIN_SIGMAS[1])] {
        let mut block = in_view.fixed_view_mut::<3, 3>(begin, begin);
        block += Matrix3::from_diagonal(&Vector3::repeat(sigma * sigma));
    }
    in_view.try_inverse().unwrap_or_else(Matrix6::zeros)
}

/// The loops that a trajectory, with its uncertainty, does not contradict.
///
/// # Arguments
/// * `covariance`: of all states of the trajectory.
pub(super) fn plausible(
    loops: Vec<RelativePose>,
    poses: &[Pose],
    covariance: &StateCovariance,
) -> Vec<RelativePose> {
    let blocks = covariance_blocks(&loops, covariance);
    let joint_covariance = |views: [usize; 2]| {
        let mut joint = SMatrix::<f64, 12, 12>::zeros();
        for (column, view) in views.iter().enumerate() {
            for (row, other) in views.iter().enumerate() {
                let block = &blocks[&(*other, *view)];
                joint.fixed_view_mut::<POSE, POSE>(POSE * row, POSE * column).copy_from(block);
            }
        }
        (joint + joint.transpose()) * (0.5 * TRAJECTORY_FACTOR * TRAJECTORY_FACTOR)
    };
    let is_plausible = |found: &RelativePose| {
        found.distance_with(poses, &joint_covariance(found.views)).is_some_and(|distance| distance <= GATE)
    };
    loops.into_iter().filter(is_plausible).collect()
}

/// Blocks of the covariance of a trajectory, by row and column, between the views of each loop.
fn covariance_blocks(
    loops: &[RelativePose],
    covariance: &StateCovariance,
) -> BTreeMap<(usize, usize), Matrix6<f64>> {
    let mut partners: BTreeMap<usize, BTreeSet<usize>> = BTreeMap::new();
    for RelativePose { views, .. } in loops {
        for view in views {
            partners.entry(*view).or_default().extend(views);
        }
    }
    let partners: Vec<(usize, BTreeSet<usize>)> = partners.into_iter().collect();
    let of_column = |index: usize| -> Vec<((usize, usize), Matrix6<f64>)> {
        let (view, rows) = &partners[index];
        let blocks = covariance.blocks(rows.iter().copied(), *view);
        rows.iter().map(|row| (*row, *view)).zip(blocks).collect()
    };
    parallel::map(partners.len(), of_column, |_| ()).into_iter().flatten().collect()
}

/// The loops that agree with the adjusted trajectory.
pub(super) fn consistent(loops: &[RelativePose], poses: &[Pose]) -> Vec<RelativePose> {
    loops.iter().filter(|found| found.distance(poses) <= GATE).cloned().collect()
}

/// Whether a relative pose is one of those that are kept. Two places of one pair of views, which images of two cameras show, differ by
/// what they say.
pub(super) fn is_kept(one: &RelativePose, kept: &[RelativePose]) -> bool {
    kept.iter().any(|kept| kept.views == one.views && kept.first_from_second == one.first_from_second)
}

/// Logs by how much refused loops are off: a place that looks like another one is metres away, one that is merely inaccurate is not.
///
/// # Arguments
/// * `found`: all loops; `kept`: those that are not refused.
/// * `poses`: as they were adjusted with them.
pub(super) fn log_refused(found: &[RelativePose], kept: &[RelativePose], poses: &[Pose]) {
    for refused in found.iter().filter(|found| !is_kept(found, kept)) {
        let [first, second] = refused.views;
        let expected = poses[first].inverse().compose(&poses[second]);
        let off = refused.first_from_second.local(&expected);
        let [rotation, position] = [off.fixed_rows::<3>(0).norm(), off.fixed_rows::<3>(3).norm()];
        tracing::debug!(first, second, off_m = position, off_deg = rotation.to_degrees(), "loop refused");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_that_is_refused_is_not_kept_by_another_one_of_the_same_views() {
        let place = |x: f64| RelativePose {
            views: [0, 3],
            first_from_second: Pose::new(nalgebra::UnitQuaternion::identity(), Vector3::new(x, 0.0, 0.0)),
            information: Matrix6::identity(),
        };
        let poses = vec![Pose::identity(); 4];
        let [right, wrong] = [place(0.1), place(12.0)];
        let kept = consistent(&[right.clone(), wrong.clone()], &poses);
        assert!(is_kept(&right, &kept) && !is_kept(&wrong, &kept));
    }
}
