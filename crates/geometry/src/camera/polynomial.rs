//! Where a polynomial first vanishes on the positive numbers, for the limits of distortion models.
//!
//! With `s = t / (1 - t)` the polynomial `sum c_k s^k` of degree n, times `(1 - t)^n`, is one on `0 <= t < 1` whose Bernstein
//! coefficients are `c_k / binomial(n, k)`. It has no root where all of them are positive; otherwise the interval is halved.
//! For `s` the square of a ray's radius, `t` is the squared sine of the ray's angle.
//!
//! Source: Farouki, "The Bernstein polynomial basis: a centennial retrospective", CAGD 2012.

/// Halvings of the interval: the root's `t` is found to rounding.
const MAX_DEPTH: usize = 60;

/// The smallest positive root of `sum c_k s^k`, whose constant term is positive; infinite where there is none.
///
/// Numbers that are not finite count as a root at zero.
pub(super) fn first_positive_root<const N: usize>(coefficients: &[f64; N]) -> f64 {
    match first_root(&bernstein(coefficients), 0.0, 1.0, MAX_DEPTH) {
        Some(t) => t / (1.0 - t),
        None => f64::INFINITY,
    }
}

/// Whether `sum c_k s^k` is positive from zero to `end` (positive), both included.
pub(super) fn is_positive_until<const N: usize>(coefficients: &[f64; N], end: f64) -> bool {
    let (until, _) = split(&bernstein(coefficients), end / (1.0 + end));
    until[N - 1] > 0.0 && first_root(&until, 0.0, 1.0, MAX_DEPTH).is_none()
}

fn bernstein<const N: usize>(coefficients: &[f64; N]) -> [f64; N] {
    let mut scaled = *coefficients;
    let mut binomial = 1.0;
    for (k, value) in scaled.iter_mut().enumerate() {
        *value /= binomial;
        binomial *= (N - 1 - k) as f64 / (k + 1) as f64;
    }
    scaled
}

/// The coefficients on both sides of a place (0 to 1) of the interval (de Casteljau).
fn split<const N: usize>(coefficients: &[f64; N], at: f64) -> ([f64; N], [f64; N]) {
    let (mut left, mut right) = (*coefficients, *coefficients);
    for (level, value) in left.iter_mut().enumerate().skip(1) {
        for k in 0..N - level {
            right[k] = (1.0 - at) * right[k] + at * right[k + 1];
        }
        *value = right[0];
    }
    (left, right)
}

/// The first root in `low..high`, or the low end of the interval that could not be decided.
fn first_root<const N: usize>(coefficients: &[f64; N], low: f64, high: f64, depth: usize) -> Option<f64> {
    let is_positive_at_low = coefficients[0] > 0.0;
    if is_positive_at_low && coefficients.iter().all(|value| *value >= 0.0) {
        return None;
    }
    let middle = 0.5 * (low + high);
    if !is_positive_at_low || depth == 0 || middle <= low || middle >= high {
        return Some(low);
    }
    let (left, right) = split(coefficients, 0.5);
    first_root(&left, low, middle, depth - 1).or_else(|| first_root(&right, middle, high, depth - 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_of_several_roots_is_found() {
        for roots in [[0.5, 2.0, 7.0], [1e-6, 1e-3, 1e6], [3.0, 3.5, 1e9]] {
            let mut product = [1.0, 0.0, 0.0, 0.0];
            for root in roots {
                for k in (1..4).rev() {
                    product[k] -= product[k - 1] / root;
                }
            }
            let found = first_positive_root(&product);
            assert!((found / roots[0] - 1.0).abs() < 1e-9, "{found} of {roots:?}");
            assert!(is_positive_until(&product, 0.999 * roots[0]));
            assert!(!is_positive_until(&product, 1.001 * roots[0]));
            // Beyond the second root it is positive again.
            assert!(!is_positive_until(&product, 0.5 * (roots[1] + roots[2])));
        }
    }

    #[test]
    fn without_a_root_there_is_no_limit() {
        assert!(first_positive_root(&[1.0, 0.0, 3.0, 0.0]).is_infinite());
        // 1 - 1.9 s + s^2 has complex roots near 1.
        assert!(first_positive_root(&[1.0, -1.9, 1.0]).is_infinite());
        assert!(is_positive_until(&[1.0, -1.9, 1.0], 1e12));
        // It touches zero at 1.
        assert!((first_positive_root(&[1.0, -2.0, 1.0]) - 1.0).abs() < 1e-6);
    }

    #[test]
    fn numbers_that_are_not_finite_end() {
        for wrong in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            for at in 1..7 {
                let mut coefficients = [1.0, -1e300, 1e300, -1e300, 1e300, -1e300, 1e300];
                coefficients[at] = wrong;
                assert!(first_positive_root(&coefficients) >= 0.0);
                is_positive_until(&coefficients, 1.0);
            }
        }
    }
}
