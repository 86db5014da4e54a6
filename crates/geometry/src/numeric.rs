//! Numeric differentiation, for testing analytic Jacobians.
//!
//! Public because the tests of all crates use it; not meant for production code.

use nalgebra::{DMatrix, DVector};

/// Default step: with the fourth-order stencil the truncation error is about 1e-16, the rounding error about
/// 1e-12 times the size of the function's value.
pub const DEFAULT_STEP: f64 = 1e-4;

/// The Jacobian at zero of a function of an error vector, by central differences of fourth order.
///
/// # Arguments
/// * `dimension`: number of elements of the error vector.
/// * `function`: maps an error (`dimension` elements) to a value, for example `|e| pose.retract(..).transform(..)`.
///   It must always return the same number of elements.
///
/// # Returns
/// The matrix (elements of the value) x `dimension`.
///
/// # Example
/// ```
/// use geometry::numeric::numeric_jacobian;
/// let jacobian = numeric_jacobian(1, |error| error.map(|x| (1.0 + x).ln()));
/// assert!((jacobian[(0, 0)] - 1.0).abs() < 1e-10);
/// ```
pub fn numeric_jacobian(
    dimension: usize,
    function: impl FnMut(&DVector<f64>) -> DVector<f64>,
) -> DMatrix<f64> {
    numeric_jacobian_with_step(dimension, DEFAULT_STEP, function)
}

/// [`numeric_jacobian`] with a given step, for functions whose natural scale is far from one.
///
/// ```text
/// f'(0) ~ (8 (f(h) - f(-h)) - (f(2h) - f(-2h))) / (12 h)
/// ```
pub fn numeric_jacobian_with_step(
    dimension: usize,
    step: f64,
    mut function: impl FnMut(&DVector<f64>) -> DVector<f64>,
) -> DMatrix<f64> {
    let mut error = DVector::zeros(dimension);
    let columns: Vec<DVector<f64>> = (0..dimension)
        .map(|column| {
            let mut at = |offset: f64| {
                error[column] = offset;
                let value = function(&error);
                error[column] = 0.0;
                value
            };
            let near = at(step) - at(-step);
            let far = at(2.0 * step) - at(-2.0 * step);
            (near * 8.0 - far) / (12.0 * step)
        })
        .collect();
    if columns.is_empty() {
        return DMatrix::zeros(function(&error).len(), 0);
    }
    DMatrix::from_columns(&columns)
}
