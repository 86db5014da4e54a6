//! The low-rank part of a joint covariance: what the poses of some keyframes, the anchors, say of all others.
//!
//! With `A` the anchors, `U U^T = P_:A P_AA^-1 P_A:`. Anchors are chosen one by one, each time the keyframe of whose pose
//! those before say least: Cholesky's decomposition of `P` by blocks, with pivots, stopped early. `P - U U^T`, the
//! covariance of all poses given those of the anchors, is positive semi-definite.

use adjustment::POSE;
use nalgebra::{Matrix6, Matrix6xX, Vector6};

/// An anchor whose remaining variance is below this part of the mean variance would add rounding only.
const NEGLIGIBLE: f64 = 1e-9;

/// The rows of `U` of each pose.
///
/// # Arguments
/// * `own`: covariance of each pose.
/// * `anchors`: at most so many, 6 columns each.
/// * `column`: `P_:j`, a block for each pose.
pub(super) fn low_rank_part(
    own: &[Matrix6<f64>],
    anchors: usize,
    column: impl Fn(usize) -> Vec<Matrix6<f64>>,
) -> Vec<Matrix6xX<f64>> {
    let anchors = anchors.min(own.len());
    let scale = mean_variances(own);
    let mut remaining = own.to_vec();
    let mut factors = vec![Matrix6xX::zeros(POSE * anchors); own.len()];
    for step in 0..anchors {
        let known = POSE * step;
        let size = |pose: &Matrix6<f64>| pose.diagonal().component_div(&scale).sum();
        let anchor = (0..own.len()).max_by(|a, b| size(&remaining[*a]).total_cmp(&size(&remaining[*b])));
        let Some((anchor, root)) =
            anchor.and_then(|anchor| Some((anchor, inverse_root(&remaining[anchor], &scale)?)))
        else {
            return factors.iter().map(|factor| factor.columns(0, known).into_owned()).collect();
        };
        let of_anchor = factors[anchor].columns(0, known).into_owned();
        for ((factor, left), block) in factors.iter_mut().zip(&mut remaining).zip(column(anchor)) {
            let beyond = block - factor.columns(0, known) * of_anchor.transpose();
            let new = beyond * root;
            factor.fixed_columns_mut::<POSE>(known).copy_from(&new);
            *left -= new * new.transpose();
        }
    }
    factors
}

/// Mean variance of the rotations, three times, and of the positions.
fn mean_variances(own: &[Matrix6<f64>]) -> Vector6<f64> {
    let sum: Vector6<f64> = own.iter().map(Matrix6::diagonal).sum();
    let [rotation, position] = [0, 3].map(|at| sum.fixed_rows::<3>(at).sum() / (3 * own.len()) as f64);
    let at_least = f64::MIN_POSITIVE;
    Vector6::from_fn(|index, _| if index < 3 { rotation.max(at_least) } else { position.max(at_least) })
}

/// `B` with `B B^T` the inverse of a covariance in the directions in which it is not negligible; `None` where it is in all.
fn inverse_root(covariance: &Matrix6<f64>, scale: &Vector6<f64>) -> Option<Matrix6<f64>> {
    let inverse_sigmas = Matrix6::from_diagonal(&scale.map(|variance| variance.sqrt().recip()));
    let scaled = inverse_sigmas * covariance * inverse_sigmas;
    let eigen = ((scaled + scaled.transpose()) * 0.5).symmetric_eigen();
    let is_clear = |value: f64| value > NEGLIGIBLE;
    let roots = eigen.eigenvalues.map(|value| if is_clear(value) { value.sqrt().recip() } else { 0.0 });
    let any = eigen.eigenvalues.iter().any(|&value| is_clear(value));
    any.then(|| inverse_sigmas * eigen.eigenvectors * Matrix6::from_diagonal(&roots))
}
