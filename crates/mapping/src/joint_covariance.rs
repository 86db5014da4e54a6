//! The joint covariance of the refined poses.
//!
//! It is the inverse of the normal equations with the landmarks eliminated. All blocks are computed column by column, and
//! those that the map states are kept.
//!
//! # Which blocks a map states
//! All, up to [`ALL_UP_TO`] keyframes. Beyond, those of keyframes near each other: omitting the rest would in general
//! leave a matrix that is no covariance, so every block is multiplied by a correlation function of the distance
//! between the two keyframes that is exactly zero beyond some distance (covariance tapering). The product of two
//! covariances, element by element, is a covariance (Schur).
//!
//! Source: Gaspari & Cohn, "Construction of correlation functions in two and three dimensions", QJRMS 1999, eq. 4.10.

use std::collections::BTreeMap;

use nalgebra::{Matrix6, Vector3};

use super::layout::{POSE, StateLayout};
use super::sparse_system::SparseFactor;

/// Maps of up to this many keyframes state the cross-covariance of every pair: that takes up to 23 MB.
pub(super) const ALL_UP_TO: usize = 400;
/// In larger maps a keyframe has cross-covariances with about this many others, on average: the size of a map then grows
/// linearly.
const MEAN_NEIGHBOURS: usize = 100;

/// Covariances and cross-covariances of the keyframes' poses, by view.
pub(super) struct JointCovariance {
    /// Covariance of each pose.
    pub(super) own: BTreeMap<usize, Matrix6<f64>>,
    /// `E[e_i e_j^T]` with `i < j`; all others are zero.
    pub(super) cross: Vec<(usize, usize, Matrix6<f64>)>,
}

/// The joint covariance of the poses of some views.
///
/// # Arguments
/// * `factor`: of the information matrix of all states.
/// * `views`: those whose covariance is wanted, at `positions` (m).
pub(super) fn joint_covariance(
    factor: &SparseFactor,
    layout: StateLayout,
    views: &[usize],
    positions: &[Vector3<f64>],
    mut progress: impl FnMut(usize, usize),
) -> JointCovariance {
    let support = (positions.len() > ALL_UP_TO).then(|| support(positions));
    let mut joint = JointCovariance { own: BTreeMap::new(), cross: Vec::new() };
    for j in 0..positions.len() {
        progress(j, positions.len());
        let columns: Vec<usize> = layout.pose(views[j]).collect();
        let inverse = factor.inverse_columns(&columns);
        let block = |i: usize| -> Matrix6<f64> {
            inverse.fixed_view::<POSE, POSE>(layout.pose(views[i]).start, 0).into()
        };
        joint.own.insert(views[j], (block(j) + block(j).transpose()) * 0.5);
        for i in 0..j {
            let distance = (positions[i] - positions[j]).norm();
            let kept = support.map_or(1.0, |support| gaspari_cohn(2.0 * distance / support));
            if kept > 0.0 {
                joint.cross.push((views[i], views[j], block(i) * kept));
            }
        }
    }
    joint
}

/// The distance (m) within which a keyframe has [`MEAN_NEIGHBOURS`] others on average.
fn support(positions: &[Vector3<f64>]) -> f64 {
    let mut distances: Vec<f64> = Vec::new();
    for (index, position) in positions.iter().enumerate() {
        distances.extend(positions[..index].iter().map(|other| (position - other).norm()));
    }
    let wanted = (positions.len() * MEAN_NEIGHBOURS / 2).min(distances.len() - 1);
    let (_, support, _) = distances.select_nth_unstable_by(wanted, f64::total_cmp);
    support.max(f64::MIN_POSITIVE)
}

/// A correlation function in three dimensions: 1 at 0, falling, exactly 0 from 2 on.
fn gaspari_cohn(z: f64) -> f64 {
    let polynomial = |coefficients: [f64; 6]| coefficients.iter().rev().fold(0.0, |sum, c| sum * z + c);
    if z < 1.0 {
        polynomial([1.0, 0.0, -5.0 / 3.0, 5.0 / 8.0, 1.0 / 2.0, -1.0 / 4.0])
    } else if z < 2.0 {
        (polynomial([4.0, -5.0, 5.0 / 3.0, 5.0 / 8.0, -1.0 / 2.0, 1.0 / 12.0]) - 2.0 / (3.0 * z)).max(0.0)
    } else {
        0.0
    }
}
