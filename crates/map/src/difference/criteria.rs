//! When an element counts as changed: by more than rounding, as of a map exported as text.

use crate::model::{CommonError, Keyframe};
use nalgebra::{Matrix6, Vector6};
use protocol::KeyframeId;

/// Smallest change of a pose (m, rad) that counts as motion; less is rounding, as of a map exported as text.
pub(super) const MIN_MOTION: f64 = 1e-6;
/// The same for a covariance, relative to its standard deviations.
const MIN_COVARIANCE_CHANGE: f64 = 1e-6;

/// Whether the pose of a keyframe or its covariance changed by more than rounding.
pub(super) fn has_moved(before: &Keyframe, now: &Keyframe) -> bool {
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
pub(super) fn is_recorrelated(before: &Matrix6<f64>, now: &Matrix6<f64>, keyframes: [&Keyframe; 2]) -> bool {
    let [rows, columns] = keyframes.map(|keyframe| keyframe.global_from_keyframe.covariance.diagonal());
    differ(before, now, [&rows, &columns])
}

/// Whether a keyframe's part of the common error changed by more than rounding.
///
/// # Arguments
/// * `before`, `now`: `None` where the map states none.
fn has_other_common_error(
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
pub(super) fn with_other_common_errors<'a, 'b>(
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
