//! Laws of rotations and poses, and of how their covariances travel.

use crate::common::Random;
use geometry::numeric::numeric_jacobian;
use geometry::{Pose, PoseWithCovariance, Rotation, compose_jacobians, inverse_jacobian, rotation};
use nalgebra::{DVector, Matrix3, Matrix6, Vector3, Vector6};
use proptest::prelude::*;

fn vector(size: f64) -> impl Strategy<Value = Vector3<f64>> {
    prop::array::uniform3(-size..size).prop_map(|v| Vector3::new(v[0], v[1], v[2]))
}

fn pose() -> impl Strategy<Value = Pose> {
    (vector(3.0), vector(50.0)).prop_map(|(phi, t)| Pose::new(rotation::exp(&phi), t))
}

fn close(a: &Pose, b: &Pose) -> bool {
    a.rotation.angle_to(&b.rotation) < 1e-7 && a.local(b).norm() < 1e-10
}

fn as_pose_error(e: &DVector<f64>) -> Vector6<f64> {
    Vector6::from_column_slice(e.as_slice())
}

fn as_values(v: &[f64]) -> DVector<f64> {
    DVector::from_column_slice(v)
}

proptest! {
    #[test]
    fn poses_are_a_group(a in pose(), b in pose(), c in pose()) {
        prop_assert!(close(&((a * b) * c), &(a * (b * c))));
        prop_assert!(close(&(a * Pose::identity()), &a) && close(&(Pose::identity() * a), &a));
        prop_assert!(close(&(a * a.inverse()), &Pose::identity()) && close(&(a.inverse() * a), &Pose::identity()));
        prop_assert!(close(&(a * b).inverse(), &(b.inverse() * a.inverse())));
    }

    #[test]
    fn poses_act_on_points(a in pose(), b in pose(), p in vector(30.0)) {
        prop_assert!(((a * b).transform(&p) - a.transform(&b.transform(&p))).norm() < 1e-10);
        prop_assert!((a.inverse_transform(&a.transform(&p)) - p).norm() < 1e-11);
        prop_assert!((a.inverse().transform(&p) - a.inverse_transform(&p)).norm() < 1e-11);
    }

    #[test]
    fn retract_undoes_local(a in pose(), b in pose(), phi in vector(1.7), dp in vector(5.0)) {
        prop_assert!(close(&a.retract(&a.local(&b)), &b));
        let error = Vector6::new(phi.x, phi.y, phi.z, dp.x, dp.y, dp.z);
        prop_assert!((a.local(&a.retract(&error)) - error).norm() < 1e-10);
    }

    #[test]
    fn the_error_is_in_the_parent_frame(a in pose(), b in pose(), phi in vector(0.5), dp in vector(1.0)) {
        let error = Vector6::new(phi.x, phi.y, phi.z, dp.x, dp.y, dp.z);
        let moved = a.retract(&error);
        prop_assert!((moved.translation - a.translation - dp).norm() < 1e-13);
        prop_assert!(moved.rotation.angle_to(&(rotation::exp(&phi) * a.rotation)) < 1e-7);
        // A fixed turn of the parent turns both halves of the error.
        let turn = Pose::new(b.rotation, Vector3::zeros());
        let turned = (turn * a).local(&(turn * moved));
        let expected = [b.rotation * phi, b.rotation * dp];
        prop_assert!((turned.fixed_rows::<3>(0) - expected[0]).norm() < 1e-10);
        prop_assert!((turned.fixed_rows::<3>(3) - expected[1]).norm() < 1e-10);
    }

    #[test]
    fn log_undoes_exp(phi in vector(1.8), exponent in -12.0..0.0_f64) {
        for v in [phi, phi * 10_f64.powf(exponent)] {
            let there_and_back = rotation::log(&rotation::exp(&v));
            prop_assert!((there_and_back - v).norm() <= 1e-12 * v.norm(), "{v} {there_and_back}");
        }
    }

    #[test]
    fn jacobians_of_so3_are_derivatives(phi in vector(1.7), exponent in -8.0..0.0_f64) {
        for v in [phi, phi * 10_f64.powf(exponent)] {
            let base = rotation::exp(&v);
            let step = |e: &DVector<f64>| rotation::exp(&(v + Vector3::new(e[0], e[1], e[2])));
            let left = numeric_jacobian(3, |e| as_values(rotation::log(&(step(e) * base.inverse())).as_slice()));
            let right = numeric_jacobian(3, |e| as_values(rotation::log(&(base.inverse() * step(e))).as_slice()));
            prop_assert!((left - rotation::left_jacobian(&v)).amax() < 1e-9);
            prop_assert!((right - rotation::right_jacobian(&v)).amax() < 1e-9);
            let identity = Matrix3::identity();
            prop_assert!((rotation::left_jacobian(&v) * rotation::left_jacobian_inverse(&v) - identity).amax() < 1e-12);
            prop_assert!((rotation::right_jacobian(&v) * rotation::right_jacobian_inverse(&v) - identity).amax() < 1e-12);
        }
    }

    #[test]
    fn jacobians_of_poses_are_derivatives(a in pose(), b in pose(), p in vector(10.0)) {
        let (by_pose, by_point) = a.transform_jacobians(&p);
        let numeric = numeric_jacobian(6, |e| as_values(a.retract(&as_pose_error(e)).transform(&p).as_slice()));
        prop_assert!((numeric - by_pose).amax() < 1e-8);
        let numeric = numeric_jacobian(3, |e| as_values(a.transform(&(p + Vector3::new(e[0], e[1], e[2]))).as_slice()));
        prop_assert!((numeric - by_point).amax() < 1e-8);

        let (by_pose, by_point) = a.inverse_transform_jacobians(&p);
        let numeric = numeric_jacobian(6, |e| as_values(a.retract(&as_pose_error(e)).inverse_transform(&p).as_slice()));
        prop_assert!((numeric - by_pose).amax() < 1e-8);
        let numeric =
            numeric_jacobian(3, |e| as_values(a.inverse_transform(&(p + Vector3::new(e[0], e[1], e[2]))).as_slice()));
        prop_assert!((numeric - by_point).amax() < 1e-8);

        let (by_a, by_b) = compose_jacobians(&a, &b);
        let product = a * b;
        let numeric = numeric_jacobian(6, |e| as_values(product.local(&(a.retract(&as_pose_error(e)) * b)).as_slice()));
        prop_assert!((numeric - by_a).amax() < 1e-8);
        let numeric = numeric_jacobian(6, |e| as_values(product.local(&(a * b.retract(&as_pose_error(e)))).as_slice()));
        prop_assert!((numeric - by_b).amax() < 1e-8);

        let inverse = a.inverse();
        let numeric =
            numeric_jacobian(6, |e| as_values(inverse.local(&a.retract(&as_pose_error(e)).inverse()).as_slice()));
        prop_assert!((numeric - inverse_jacobian(&a)).amax() < 1e-8);
    }

    #[test]
    fn uncertain_poses_are_a_group_action(a in pose(), b in pose(), seed in 0_u64..1000) {
        let uncertain = PoseWithCovariance::new(a, random_covariance(seed, 0.1));
        let twice = uncertain.inverse().inverse();
        prop_assert!((twice.covariance - uncertain.covariance).amax() < 1e-9 * uncertain.covariance.amax() * 1e3);
        let exact = PoseWithCovariance::exact(b);
        let scale = 1.0 + b.translation.norm_squared();
        let left = exact.compose(&uncertain).covariance - uncertain.change_of_parent(&b).covariance;
        let right = uncertain.compose(&exact).covariance - uncertain.change_of_child(&b).covariance;
        prop_assert!(left.amax() < 1e-12 * scale && right.amax() < 1e-12 * scale);
    }
}

#[test]
fn log_is_right_at_half_a_turn_and_for_both_signs_of_the_quaternion() {
    for axis in [Vector3::x(), Vector3::y(), Vector3::new(0.6, 0.0, -0.8)] {
        let half_turn = rotation::exp(&(axis * std::f64::consts::PI));
        assert!((rotation::log(&half_turn).norm() - std::f64::consts::PI).abs() < 1e-12);
        let r = rotation::exp(&(axis * 0.7));
        let negated = Rotation::new_unchecked(-r.into_inner());
        assert!((rotation::log(&negated) - axis * 0.7).norm() < 1e-14);
    }
}

#[test]
fn decoded_poses_are_checked() {
    let good = Pose::new(rotation::exp(&Vector3::new(0.1, 0.2, 0.3)), Vector3::new(1.0, 2.0, 3.0));
    assert!(good.check_unit());
    let scaled = Pose { rotation: Rotation::new_unchecked(good.rotation.into_inner() * 1.1), ..good };
    assert!(!scaled.check_unit());
    let nan = Pose { translation: Vector3::new(f64::NAN, 0.0, 0.0), ..good };
    assert!(!nan.check_unit());
    let plausible = PoseWithCovariance::new(good, Matrix6::identity());
    assert!(plausible.is_plausible() && !PoseWithCovariance::new(good, -Matrix6::identity()).is_plausible());
    let mut lopsided = Matrix6::identity();
    lopsided[(0, 1)] = 0.5;
    assert!(!PoseWithCovariance::new(good, lopsided).is_plausible());
}

fn random_covariance(seed: u64, sigma: f64) -> Matrix6<f64> {
    let mut random = Random::new(seed);
    let factor = Matrix6::from_fn(|_, _| random.normal()) * sigma;
    factor * factor.transpose() + Matrix6::identity() * (0.1 * sigma * sigma)
}

/// Largest entry of the sample covariance's departure, in units of the standard deviations.
fn departure(samples: &[Vector6<f64>], covariance: &Matrix6<f64>) -> f64 {
    let sample: Matrix6<f64> =
        samples.iter().map(|e| e * e.transpose()).sum::<Matrix6<f64>>() / samples.len() as f64;
    let sigma = covariance.diagonal().map(f64::sqrt);
    (sample - covariance).component_div(&(sigma * sigma.transpose())).amax()
}

#[test]
fn covariances_travel_as_samples_do() {
    const SAMPLES: usize = 20_000;
    // Five standard deviations of a sample covariance.
    let tolerance = 5.0 * (2.0 / SAMPLES as f64).sqrt();
    let mut random = Random::new(3);
    let (a, b) = (random.pose(5.0), random.pose(5.0));
    // Both errors from 12 common numbers, so that they are correlated. Small, because the propagation is of first order.
    let mix_a = nalgebra::SMatrix::<f64, 6, 12>::from_fn(|_, _| 1e-3 * random.normal());
    let mix_b = nalgebra::SMatrix::<f64, 6, 12>::from_fn(|_, _| 1e-3 * random.normal());
    let uncertain_a = PoseWithCovariance::new(a, mix_a * mix_a.transpose());
    let uncertain_b = PoseWithCovariance::new(b, mix_b * mix_b.transpose());
    let correlated = uncertain_a.compose_correlated(&uncertain_b, &(mix_a * mix_b.transpose()));
    let independent = uncertain_a.compose(&uncertain_b);
    let inverse = uncertain_a.inverse();
    let moved = uncertain_a.change_of_parent(&b);
    let mut samples = [Vec::new(), Vec::new(), Vec::new(), Vec::new()];
    let mut nees = 0.0;
    for _ in 0..SAMPLES {
        let (x, y) = (random.normal_vector::<12>(), random.normal_vector::<12>());
        let sample_a = a.retract(&(mix_a * x));
        samples[0].push(correlated.pose.local(&(sample_a * b.retract(&(mix_b * x)))));
        samples[1].push(independent.pose.local(&(sample_a * b.retract(&(mix_b * y)))));
        samples[2].push(inverse.pose.local(&sample_a.inverse()));
        samples[3].push(moved.pose.local(&(b * sample_a)));
        nees += correlated.nees(&(sample_a * b.retract(&(mix_b * x)))).unwrap() / SAMPLES as f64;
    }
    for (set, expected) in samples.iter().zip([correlated, independent, inverse, moved]) {
        let found = departure(set, &expected.covariance);
        assert!(found < tolerance, "{found}");
    }
    assert!((nees - 6.0).abs() < 0.15, "{nees}");
}
