//! Absolute orientation: the rigid motion between two sets of points.

use super::PnpError;
use crate::pose::Pose;
use crate::rotation::Rotation;
use nalgebra::{Matrix3, Rotation3, Vector3};

/// The pose `a_from_b` that aligns the points of frame b with those of frame a by least squares.
///
/// Source: Umeyama, PAMI 1991.
///
/// # Errors
/// [`PnpError::Degenerate`] if the decomposition fails.
pub(super) fn align_points(in_a: &[Vector3<f64>], in_b: &[Vector3<f64>]) -> Result<Pose, PnpError> {
    let (mean_a, mean_b) = (mean(in_a), mean(in_b));
    let correlation: Matrix3<f64> =
        in_a.iter().zip(in_b).map(|(a, b)| (a - mean_a) * (b - mean_b).transpose()).sum();
    let svd = correlation.svd(true, true);
    let (Some(u), Some(vt)) = (svd.u, svd.v_t) else { return Err(PnpError::Degenerate) };
    let handedness = (u.determinant() * vt.determinant()).signum();
    let matrix = u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, handedness)) * vt;
    let rotation = Rotation::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix));
    Ok(Pose::new(rotation, mean_a - rotation * mean_b))
}

/// The centroid.
pub(super) fn mean(points: &[Vector3<f64>]) -> Vector3<f64> {
    points.iter().sum::<Vector3<f64>>() / points.len() as f64
}
