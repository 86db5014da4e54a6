//! Robust loss of nonlinear least squares.

/// Huber's loss: quadratic up to a threshold, linear beyond.
///
/// # Arguments
/// * `length`: norm of the residual in standard deviations, not negative.
/// * `threshold`: in standard deviations; infinite for least squares.
///
/// # Returns
/// The weight of iteratively reweighted least squares (1 up to the threshold) and the loss.
///
/// # Example
/// ```
/// use geometry::robust::huber;
///
/// assert_eq!(huber(1.0, 2.0), (1.0, 0.5));
/// assert_eq!(huber(4.0, 2.0), (0.5, 6.0));
/// ```
///
/// Source: Huber, "Robust estimation of a location parameter", Annals of Mathematical Statistics 1964.
pub fn huber(length: f64, threshold: f64) -> (f64, f64) {
    if length <= threshold {
        (1.0, 0.5 * length * length)
    } else {
        (threshold / length, threshold * (length - 0.5 * threshold))
    }
}
