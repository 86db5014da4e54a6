//! Alignment of an estimated trajectory with the true one, where the estimate has a frame of its own.

use geometry::pose::Pose;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use thiserror::Error;

/// Singular values of the covariance of positions below this (relative to the largest) count as zero.
const DEGENERATE: f64 = 1e-12;

/// Which transformation aligns an estimate with the truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Alignment {
    /// None: both are in the same frame.
    None,
    /// A rotation about gravity and a translation: the four unobservable directions of visual-inertial odometry. Both
    /// fields are the unit direction of gravity.
    Yaw {
        /// In the frame of the reference.
        gravity_in_reference: Vector3<f64>,
        /// In the frame of the estimate.
        gravity_in_estimate: Vector3<f64>,
    },
    /// A rotation and a translation.
    Se3,
}

/// Why trajectories could not be aligned.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum AlignmentError {
    /// There is nothing to align.
    #[error("the trajectories have no poses in common: check their times, or allow a larger time difference")]
    NoPairs,
    /// The positions are on a line, or all the same.
    #[error("the positions lie on one line, which leaves the rotation undetermined: align with yaw or none")]
    Degenerate,
}

/// The rigid transformation (no scale) that minimizes the sum of squared distances between positions.
///
/// # Arguments
/// * `pairs`: n pairs of position in the reference and position in the estimate, metres.
///
/// # Returns
/// `reference_from_estimate`.
///
/// # Errors
/// [`AlignmentError::NoPairs`] without pairs, [`AlignmentError::Degenerate`] where the positions lie on one line and the
/// whole rotation is asked for.
///
/// Source: Umeyama, PAMI 1991, without scale; about gravity, the angle that maximizes the same sum in closed form.
///
/// ```
/// use evaluation::{Alignment, align};
/// use nalgebra::Vector3;
///
/// let shift = Vector3::new(1.0, 2.0, 3.0);
/// let corners = [Vector3::zeros(), Vector3::x(), Vector3::y()];
/// let pairs: Vec<_> = corners.map(|corner| (corner + shift, corner)).to_vec();
/// let reference_from_estimate = align(&pairs, &Alignment::Se3)?;
/// assert!((reference_from_estimate.translation - shift).norm() < 1e-9);
/// # Ok::<(), evaluation::AlignmentError>(())
/// ```
pub fn align(pairs: &[(Vector3<f64>, Vector3<f64>)], alignment: &Alignment) -> Result<Pose, AlignmentError> {
    let mut sums = PositionSums::default();
    for (reference, estimate) in pairs {
        sums.push(reference, estimate);
    }
    sums.align(alignment)
}

/// The factor on the estimate's positions with which it fits the reference best, for an estimate of one camera whose scale is
/// unknown. Scaled by it, the estimate is to be aligned with [`Alignment::Se3`].
///
/// # Errors
/// As [`align`]; also [`AlignmentError::Degenerate`] where the estimate does not move.
///
/// Source: Umeyama, PAMI 1991.
///
/// ```
/// use nalgebra::Vector3;
///
/// let corners = [Vector3::zeros(), Vector3::x(), Vector3::y()];
/// let pairs: Vec<_> = corners.map(|corner| (2.5 * corner + Vector3::z(), corner)).to_vec();
/// assert!((evaluation::alignment_scale(&pairs)? - 2.5).abs() < 1e-9);
/// # Ok::<(), evaluation::AlignmentError>(())
/// ```
pub fn alignment_scale(pairs: &[(Vector3<f64>, Vector3<f64>)]) -> Result<f64, AlignmentError> {
    let rotation = align(pairs, &Alignment::Se3)?.rotation;
    let count = pairs.len() as f64;
    let mean_reference = pairs.iter().map(|(reference, _)| reference).sum::<Vector3<f64>>() / count;
    let mean_estimate = pairs.iter().map(|(_, estimate)| estimate).sum::<Vector3<f64>>() / count;
    let (mut product, mut square) = (0.0, 0.0);
    for (reference, estimate) in pairs {
        let centred = rotation * (estimate - mean_estimate);
        product += (reference - mean_reference).dot(&centred);
        square += centred.norm_squared();
    }
    let scale = product / square;
    if scale.is_finite() && scale > 0.0 { Ok(scale) } else { Err(AlignmentError::Degenerate) }
}

/// The sums over pairs of positions that determine an alignment: constant memory for any number of pairs.
#[derive(Clone, Copy, Debug, Default)]
pub struct PositionSums {
    count: usize,
    /// The first pair. Sums are about it: far from the origin the products of coordinates would lose digits.
    origin: (Vector3<f64>, Vector3<f64>),
    reference: Vector3<f64>,
    estimate: Vector3<f64>,
    products: Matrix3<f64>,
}

impl PositionSums {
    /// Adds a pair: position in the reference, position in the estimate, metres.
    pub fn push(&mut self, reference: &Vector3<f64>, estimate: &Vector3<f64>) {
        if self.count == 0 {
            self.origin = (*reference, *estimate);
        }
        self.count += 1;
        let (reference, estimate) = (reference - self.origin.0, estimate - self.origin.1);
        self.reference += reference;
        self.estimate += estimate;
        self.products += reference * estimate.transpose();
    }

    /// The alignment of the pairs that were added; see [`align`].
    ///
    /// # Errors
    /// [`AlignmentError`].
    pub fn align(&self, alignment: &Alignment) -> Result<Pose, AlignmentError> {
        if self.count == 0 {
            return Err(AlignmentError::NoPairs);
        }
        let count = self.count as f64;
        let (mean_reference, mean_estimate) = (self.reference / count, self.estimate / count);
        let correlation = self.products / count - mean_reference * mean_estimate.transpose();
        let rotation = match alignment {
            Alignment::None => return Ok(Pose::identity()),
            Alignment::Yaw { gravity_in_reference, gravity_in_estimate } => {
                about_gravity(&correlation, gravity_in_reference, gravity_in_estimate)
            }
            Alignment::Se3 => best_rotation(&correlation)?,
        };
        let (reference, estimate) = (self.origin.0 + mean_reference, self.origin.1 + mean_estimate);
        Ok(Pose::new(rotation, reference - rotation * estimate))
    }
}

/// The rotation `R` that maximizes `trace(R^T correlation)`.
fn best_rotation(correlation: &Matrix3<f64>) -> Result<UnitQuaternion<f64>, AlignmentError> {
    let svd = correlation.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else { return Err(AlignmentError::Degenerate) };
    let mut order = [0, 1, 2];
    order.sort_unstable_by(|a, b| svd.singular_values[*b].total_cmp(&svd.singular_values[*a]));
    if svd.singular_values[order[1]] <= DEGENERATE * svd.singular_values[order[0]].max(f64::MIN_POSITIVE) {
        return Err(AlignmentError::Degenerate);
    }
    let mut signs = Matrix3::identity();
    if u.determinant() * v_t.determinant() < 0.0 {
        signs[(order[2], order[2])] = -1.0;
    }
    let rotation = Rotation3::from_matrix_unchecked(u * signs * v_t);
    Ok(UnitQuaternion::new_normalize(UnitQuaternion::from_rotation_matrix(&rotation).into_inner()))
}

/// The best of the rotations that map one direction of gravity to the other.
fn about_gravity(
    correlation: &Matrix3<f64>,
    gravity_in_reference: &Vector3<f64>,
    gravity_in_estimate: &Vector3<f64>,
) -> UnitQuaternion<f64> {
    let level = rotation_between(gravity_in_reference, gravity_in_estimate);
    // Correlation of the reference with the levelled estimate. With R = Exp(angle axis),
    // trace(R^T C) = const + cos(angle) * (trace(C) - axis^T C axis) + sin(angle) * axis^T vee(C - C^T).
    let levelled = correlation * level.to_rotation_matrix().matrix().transpose();
    let axis = gravity_in_reference.normalize();
    let skew = levelled - levelled.transpose();
    let sine = axis.dot(&Vector3::new(skew[(2, 1)], skew[(0, 2)], skew[(1, 0)]));
    let cosine = levelled.trace() - axis.dot(&(levelled * axis));
    UnitQuaternion::from_scaled_axis(axis * sine.atan2(cosine)) * level
}

/// The shortest rotation that maps `from` to `to`.
pub(crate) fn rotation_between(to: &Vector3<f64>, from: &Vector3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::rotation_between(from, to).unwrap_or_else(|| {
        // Opposite directions: half a turn about any axis across.
        let across = from.cross(&Vector3::ith(from.iamin(), 1.0)).normalize();
        UnitQuaternion::from_scaled_axis(across * std::f64::consts::PI)
    })
}
