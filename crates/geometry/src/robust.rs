//! The robust loss that triangulation and pose refinement share.

/// Weight and loss of a residual of some length (in standard deviations) under Huber's function: quadratic up to the
/// threshold, linear beyond.
pub fn huber(length: f64, threshold: f64) -> (f64, f64) {
    if length <= threshold {
        (1.0, 0.5 * length * length)
    } else {
        (threshold / length, threshold * (length - 0.5 * threshold))
    }
}
