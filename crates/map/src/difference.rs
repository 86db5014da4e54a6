//! What counts as a change between two versions of a map.
//!
//! A robot's state is correlated with the old errors of the keyframes that it holds, not with the new ones: it has to know which
//! keyframes moved, and how far the map as a whole did. The size of the motion is the root mean square over the keyframes that
//! both versions have, per axis, of the rotation from the old to the new pose and of the change of position. A rigid motion of
//! the whole map is thus measured at the keyframes, where robots are, and not at the origin of its frame.

use crate::model::{CommonError, Keyframe};
use geometry::Pose;
use nalgebra::{Matrix6, Vector6};
use protocol::{KeyframeId, StatedChange};

/// Smallest change of a pose (m, rad) that counts as motion; less is rounding, as of a map exported as text.
const MIN_MOTION: f64 = 1e-6;
/// The same for a covariance, relative to its standard deviations.
const MIN_COVARIANCE_CHANGE: f64 = 1e-6;

/// Whether the pose of a keyframe or its covariance changed by more than rounding.
pub fn has_moved(before: &Keyframe, now: &Keyframe) -> bool {
    let (before, now) = (&before.global_from_keyframe, &now.global_from_keyframe);
    let variances = before.covariance.diagonal();
    before.pose.local(&now.pose).amax() > MIN_MOTION
        || differ(&before.covariance, &now.covariance, [&variances, &variances])
}

/// Whether the cross-covariance of two keyframes changed by more than rounding.
///
/// # Arguments
/// * `before`, `now`: `E[e_a e_bᵀ]`, rows of the first keyframe; zero where the two are independent.
/// * `keyframes`: the first and the second one.
pub fn is_recorrelated(before: &Matrix6<f64>, now: &Matrix6<f64>, keyframes: [&Keyframe; 2]) -> bool {
    let [rows, columns] = keyframes.map(|keyframe| keyframe.global_from_keyframe.covariance.diagonal());
    differ(before, now, [&rows, &columns])
}

/// Whether a keyframe's part of the common error changed by more than rounding.
///
/// # Arguments
/// * `before`, `now`: `None` where the map states none.
pub fn has_other_common_error(
    before: Option<&CommonError>,
    now: Option<&CommonError>,
    keyframe: &Keyframe,
) -> bool {
    let (before, now) = match (before, now) {
        (None, None) => return false,
        (Some(before), Some(now)) if before.factor.ncols() == now.factor.ncols() => (before, now),
        _ => return true,
    };
    let variances = keyframe.global_from_keyframe.covariance.diagonal();
    let change = &now.factor - &before.factor;
    let row_differs = |(row, variance): (usize, &f64)| {
        change.row(row).amax() > MIN_COVARIANCE_CHANGE * variance.max(0.0).sqrt()
    };
    variances.iter().enumerate().any(row_differs)
}

/// The keyframes with a common error, where that of any is another one: then what all of them have in common is.
///
/// # Arguments
/// * `keyframes`: those of both versions.
/// * `common`: a keyframe's part of the common error, before and now.
pub fn with_other_common_errors<'a, 'b>(
    keyframes: impl Iterator<Item = &'a Keyframe>,
    common: impl Fn(KeyframeId) -> [Option<&'b CommonError>; 2],
) -> Vec<KeyframeId> {
    let (mut with_any, mut is_other) = (Vec::new(), false);
    for keyframe in keyframes {
        let [before, now] = common(keyframe.id);
        is_other |= has_other_common_error(before, now, keyframe);
        if before.is_some() || now.is_some() {
            with_any.push(keyframe.id);
        }
    }
    if is_other { with_any } else { Vec::new() }
}

/// Whether two covariances of the same errors differ.
///
/// # Arguments
/// * `variances`: of the errors of the rows and of the columns.
fn differ(before: &Matrix6<f64>, now: &Matrix6<f64>, variances: [&Vector6<f64>; 2]) -> bool {
    let [rows, columns] = variances;
    let scale = |row: usize, column: usize| (rows[row] * columns[column]).max(0.0).sqrt();
    let entry_differs = |row, column| {
        let change: f64 = now[(row, column)] - before[(row, column)];
        change.abs() > MIN_COVARIANCE_CHANGE * scale(row, column)
    };
    (0..6).any(|row| (0..6).any(|column| entry_differs(row, column)))
}

/// The motion of a map, summed over the keyframes that both versions have.
#[derive(Clone, Copy, Debug, Default)]
pub struct Motion {
    keyframes: usize,
    squared_angle: f64,
    squared_distance: f64,
}

impl Motion {
    /// Adds a keyframe that both versions have.
    pub fn add(&mut self, before: &Pose, now: &Pose) {
        self.keyframes += 1;
        self.squared_angle += before.rotation.angle_to(&now.rotation).powi(2);
        self.squared_distance += (now.translation - before.translation).norm_squared();
    }

    /// Adds keyframes that did not move.
    pub fn add_unmoved(&mut self, keyframes: usize) {
        self.keyframes += keyframes;
    }

    /// The size of the motion; `None` if no keyframe is in both versions.
    pub fn size(&self) -> Option<StatedChange> {
        let per_axis = |squared: f64| (squared / (3 * self.keyframes) as f64).sqrt();
        (self.keyframes > 0).then(|| StatedChange {
            sigma_theta_rad: per_axis(self.squared_angle),
            sigma_p_m: per_axis(self.squared_distance),
        })
    }
}
