//! How well a position is known, as VDA 5050 states it.

use geometry::PoseWithCovariance;

/// Chi-square of two degrees of freedom that 95 % of all errors stay below.
const CHI_SQUARE_95: f64 = 5.991_464_547_107_98;

/// Variance of the horizontal position along the axis in which it is known worst, m^2.
///
/// # Arguments
/// * `pose`: in a frame whose z axis is vertical, errors `[δθ, δp]`.
fn worst_horizontal_variance(pose: &PoseWithCovariance) -> f64 {
    let covariance = &pose.covariance;
    let (xx, xy, yy) = (covariance[(3, 3)], covariance[(3, 4)], covariance[(4, 4)]);
    f64::midpoint(xx, yy) + ((xx - yy) / 2.0).hypot(xy)
}

/// The longer half axis of the ellipse that holds the horizontal position with 95 %, metres.
///
/// # Arguments
/// * `pose`: of the vehicle, in a frame whose z axis is vertical.
pub fn deviation_range_m(pose: &PoseWithCovariance) -> f64 {
    (CHI_SQUARE_95 * worst_horizontal_variance(pose)).sqrt()
}

/// The probability that the horizontal position is within a tolerance, at least: that of an error which is in all directions as large as
/// in the worst, `1 - exp(-t^2 / 2s^2)`.
///
/// # Arguments
/// * `pose`: of the vehicle, in a frame whose z axis is vertical.
/// * `tolerance_m`: `t`, metres.
///
/// # Returns
/// 0 to 1.
pub fn localization_score(pose: &PoseWithCovariance, tolerance_m: f64) -> f64 {
    let exponent = tolerance_m.powi(2) / (2.0 * worst_horizontal_variance(pose));
    // An exact pose is within any tolerance.
    if exponent.is_nan() { 1.0 } else { -(-exponent).exp_m1() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::Pose;
    use nalgebra::{Matrix2, Matrix6};

    fn known(horizontal: Matrix2<f64>) -> PoseWithCovariance {
        let mut covariance = Matrix6::identity();
        covariance.fixed_view_mut::<2, 2>(3, 3).copy_from(&horizontal);
        PoseWithCovariance::new(Pose::identity(), covariance)
    }

    #[test]
    fn the_range_is_that_of_the_worst_direction_in_any_axes() {
        for degrees in 0..180 {
            let (sin, cos) = f64::from(degrees).to_radians().sin_cos();
            let axes = Matrix2::new(cos, -sin, sin, cos);
            let turned = axes * Matrix2::new(0.04, 0.0, 0.0, 0.0009) * axes.transpose();
            let range = deviation_range_m(&known(turned));
            assert!((range - 0.2 * CHI_SQUARE_95.sqrt()).abs() < 1e-12, "{range}");
        }
    }

    #[test]
    fn the_score_is_a_probability_that_falls_with_the_uncertainty() {
        let score = |sigma: f64| localization_score(&known(Matrix2::identity() * sigma * sigma), 0.1);
        assert!((score(0.0) - 1.0).abs() < f64::EPSILON);
        assert!((score(0.1) - (1.0 - (-0.5_f64).exp())).abs() < 1e-12);
        let falling: Vec<f64> = (0..40).map(|step| score(0.001 * 1.5_f64.powi(step))).collect();
        assert!(falling.is_sorted_by(|first, next| first >= next), "{falling:?}");
        assert!(falling[0] > 0.999_999 && falling[39] < 1e-6);
        // Known well in one direction only: not better than in the worst.
        let long = known(Matrix2::new(1.0, 0.0, 0.0, 1e-6));
        assert!((localization_score(&long, 0.1) - score(1.0)).abs() < 1e-12);
    }
}
