//! NEES is 1 for a consistent filter, and only for a consistent one.

use super::*;
use geometry::uncertain_pose::PoseWithCovariance;
use nalgebra::{Matrix6, Vector6};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

/// A standard normal number (sum of uniform ones is near enough for a mean of squares).
fn normal(rng: &mut StdRng) -> f64 {
    (0..12).map(|_| rng.random_range(-0.5..0.5)).sum()
}

/// Mean NEES of estimates whose errors are `factor` times as large as their covariance says.
fn mean_nees(factor: f64) -> Nees {
    let mut rng = StdRng::seed_from_u64(3);
    let root = Matrix6::from_fn(|_, _| rng.random_range(-0.05..0.05)) + Matrix6::identity() * 0.05;
    let truth = Pose::new(rotation(1.0, 0.5, -2.0), Vector3::new(3.0, -8.0, 1.0));
    let mut sum = NeesSum::default();
    for _ in 0..4000 {
        let error: Vector6<f64> = root * Vector6::from_fn(|_, _| normal(&mut rng)) * factor;
        // The estimate from which the truth is `error` away.
        let rotation = UnitQuaternion::from_scaled_axis(error.fixed_rows::<3>(0).into_owned()).inverse()
            * truth.rotation;
        let pose = Pose::new(rotation, truth.translation - error.fixed_rows::<3>(3));
        sum.push(&nees(&PoseWithCovariance::new(pose, root * root.transpose()), &truth).unwrap());
    }
    sum.mean().unwrap()
}

#[test]
fn consistent_estimates_have_a_nees_of_one_within_the_bounds() {
    let mean = mean_nees(1.0);
    for (value, degrees) in [(mean.rotation, 3), (mean.position, 3), (mean.pose, 6)] {
        let (low, high) = nees_bounds(degrees, 4000, 0.999).unwrap();
        assert!(low < 1.0 && 1.0 < high && (low..high).contains(&value), "{value} not in {low}..{high}");
    }
}

#[test]
fn an_estimate_twice_as_wrong_as_it_says_has_a_nees_of_four() {
    let (consistent, overconfident) = (mean_nees(1.0), mean_nees(2.0));
    assert!((overconfident.pose / consistent.pose - 4.0).abs() < 1e-9);
}

#[test]
fn the_bounds_are_those_of_the_chi_square_table() {
    // Chi-square with 6 degrees of freedom: 1.237 and 14.449 cut off 2.5 % at each end.
    let (low, high) = nees_bounds(6, 1, 0.95).unwrap();
    assert!((low * 6.0 - 1.237).abs() < 1e-3 && (high * 6.0 - 14.449).abs() < 1e-3);
    assert_eq!(nees_bounds(6, 0, 0.95), None);
    assert_eq!(nees_bounds(6, 1, 1.0), None);
}

#[test]
fn an_exact_estimate_has_no_nees() {
    assert_eq!(nees(&PoseWithCovariance::new(Pose::identity(), Matrix6::zeros()), &Pose::identity()), None);
}
