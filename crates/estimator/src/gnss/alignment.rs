//! `global_from_local` from positions of the antenna in both frames: yaw and position by least squares.
//!
//! G has z up, as ENU does, and L has, so that four of six numbers are unknown. Readings that fit the others badly are left
//! out. The errors of readings are alike over the correlation time, and each is worth less accordingly.

use crate::state::POSE_DIM;
use geometry::rotation::skew;
use geometry::{Pose, PoseWithCovariance};
use nalgebra::{Matrix3, Matrix3x4, Matrix4, Matrix6, SMatrix, UnitQuaternion, Vector3, Vector4};

/// Fewest readings that are aligned.
const MIN_READINGS: usize = 5;
/// Part of the readings that must fit.
const MOST: f64 = 0.8;
/// Squared residual of a reading that fits, in units of its covariance: 99.9 % of three degrees of freedom.
const FITS: f64 = 16.27;
/// Error of odometry as a fraction of the way, for the test of residuals.
const DRIFT: f64 = 0.01;
const ITERATIONS: usize = 5;
const ROUNDS: usize = 4;

/// The antenna at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Located {
    pub(crate) stamp_ns: i64,
    /// By odometry, in L.
    pub(crate) in_local: Vector3<f64>,
    /// As it is measured, in G.
    pub(crate) in_global: Vector3<f64>,
    /// Of the measured position, m^2.
    pub(crate) covariance: Matrix3<f64>,
}

/// What an alignment found.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Alignment {
    /// `global_from_local`, with the covariance of its error in L as the filter has it.
    pub(crate) transform: PoseWithCovariance,
    /// Standard deviation of its yaw, rad.
    pub(crate) sigma_yaw_rad: f64,
}

/// Why readings are not aligned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Unaligned {
    /// There are too few, or they do not differ.
    TooFew,
    /// They do not follow odometry.
    Misfit,
}

/// By how much readings at such intervals are worth less than independent ones, as the sum of an exponential correlation.
pub(crate) fn inflation(interval_s: f64, correlation_time_s: f64) -> f64 {
    let correlation = (-interval_s.max(0.0) / correlation_time_s).exp();
    (1.0 + correlation) / (1.0 - correlation).max(1e-6)
}

/// Aligns readings.
///
/// # Arguments
/// * `located`: in order of time.
/// * `local_now`: the newest position of the IMU in L, and the covariance of the pose there: what odometry may have lost.
///
/// # Errors
/// [`Unaligned`].
pub(crate) fn align(
    located: &[Located],
    correlation_time_s: f64,
    sigma_tilt_rad: f64,
    local_now: &PoseWithCovariance,
) -> Result<Alignment, Unaligned> {
    let newest = located.last().ok_or(Unaligned::TooFew)?.in_local;
    let mut used: Vec<Located> = located.to_vec();
    let count = used.len();
    for _ in 0..ROUNDS {
        if (used.len() as f64) < MOST * count as f64 {
            return Err(Unaligned::Misfit);
        }
        let (&[first, .., last], true) = (used.as_slice(), used.len() >= MIN_READINGS) else {
            return Err(Unaligned::TooFew);
        };
        let (pose, information) = fit(&used).ok_or(Unaligned::TooFew)?;
        let misfit = |one: &Located| {
            let residual = one.in_global - pose.transform(&one.in_local);
            let drift = DRIFT * (one.in_local - newest).norm();
            let covariance = one.covariance + Matrix3::identity() * (drift * drift);
            covariance.cholesky().map_or(f64::INFINITY, |factor| residual.dot(&factor.solve(&residual)))
        };
        let before = used.len();
        used.retain(|one| misfit(one) <= FITS);
        if used.len() < before {
            continue;
        }
        let span_s = (last.stamp_ns - first.stamp_ns) as f64 * 1e-9;
        let interval_s = span_s / (used.len() - 1) as f64;
        let own =
            information.try_inverse().ok_or(Unaligned::TooFew)? * inflation(interval_s, correlation_time_s);
        let centre = used.iter().map(|one| one.in_local).sum::<Vector3<f64>>() / used.len() as f64;
        let covariance = whole_covariance(&own, &centre, sigma_tilt_rad, local_now);
        let sigma_yaw_rad = covariance[(2, 2)].sqrt();
        return Ok(Alignment { transform: PoseWithCovariance::new(pose, covariance), sigma_yaw_rad });
    }
    Err(Unaligned::Misfit)
}

/// Root mean square distance of the readings from their mean, metres: in L, and in G.
pub(crate) fn extents(located: &[Located]) -> [f64; 2] {
    let extent = |at: fn(&Located) -> Vector3<f64>| {
        let count = located.len().max(1) as f64;
        let mean = located.iter().map(at).sum::<Vector3<f64>>() / count;
        (located.iter().map(|one| (at(one) - mean).norm_squared()).sum::<f64>() / count).sqrt()
    };
    [extent(|one| one.in_local), extent(|one| one.in_global)]
}

/// The covariance of all six numbers, of a tilt about the middle of the readings, and of what odometry may have lost since.
fn whole_covariance(
    own: &Matrix4<f64>,
    centre: &Vector3<f64>,
    sigma_tilt_rad: f64,
    local_now: &PoseWithCovariance,
) -> Matrix6<f64> {
    let mut covariance = Matrix6::zeros();
    covariance.fixed_view_mut::<4, 4>(2, 2).copy_from(own);
    // A turn of the transform about a point of L leaves that where it is: `-[a]x e_R + e_p = 0`.
    let turn_about = |point: &Vector3<f64>| {
        let mut turn = SMatrix::<f64, POSE_DIM, 3>::zeros();
        turn.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::identity());
        turn.fixed_view_mut::<3, 3>(3, 0).copy_from(&skew(point));
        turn
    };
    let tilt = turn_about(centre).fixed_columns::<2>(0) * sigma_tilt_rad;
    covariance += tilt * tilt.transpose();
    let yaw =
        turn_about(&local_now.pose.translation).column(2) * local_now.covariance[(2, 2)].max(0.0).sqrt();
    covariance += yaw * yaw.transpose();
    let mut position = covariance.fixed_view_mut::<3, 3>(3, 3);
    position += local_now.covariance.fixed_view::<3, 3>(3, 3);
    covariance
}

/// Weighted least squares of yaw and position, and its information about `[e_yaw, e_p]` in L.
fn fit(used: &[Located]) -> Option<(Pose, Matrix4<f64>)> {
    let mut pose = first_pose(used);
    let mut information = Matrix4::zeros();
    for _ in 0..ITERATIONS {
        information = Matrix4::zeros();
        let mut vector = Vector4::zeros();
        let local_from_global = pose.rotation.inverse().to_rotation_matrix().into_inner();
        for one in used {
            let residual = local_from_global * (one.in_global - pose.translation) - one.in_local;
            let in_local = local_from_global * one.covariance * local_from_global.transpose();
            let inverse = in_local.try_inverse()?;
            let mut jacobian = Matrix3x4::zeros();
            jacobian.set_column(0, &Vector3::z().cross(&one.in_local));
            jacobian.fixed_view_mut::<3, 3>(0, 1).copy_from(&Matrix3::identity());
            information += jacobian.transpose() * inverse * jacobian;
            vector += jacobian.transpose() * inverse * residual;
        }
        let step = information.cholesky()?.solve(&vector);
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), step[0]);
        let shift = pose.rotation * step.fixed_rows::<3>(1).into_owned();
        pose = Pose::new(pose.rotation * turn, pose.translation + shift);
    }
    pose.is_finite().then_some((pose, information))
}

/// Yaw by the horizontal deviations from the means.
fn first_pose(used: &[Located]) -> Pose {
    let count = used.len() as f64;
    let local = used.iter().map(|one| one.in_local).sum::<Vector3<f64>>() / count;
    let global = used.iter().map(|one| one.in_global).sum::<Vector3<f64>>() / count;
    let (mut sine, mut cosine) = (0.0, 0.0);
    for one in used {
        let (a, b) = (one.in_local - local, one.in_global - global);
        sine += a.x * b.y - a.y * b.x;
        cosine += a.x * b.x + a.y * b.y;
    }
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), sine.atan2(cosine));
    Pose::new(rotation, global - rotation * local)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::state::local_error;
    use geometry::rotation;
    use rand::{RngExt as _, SeedableRng, rngs::StdRng};

    fn truth() -> Pose {
        Pose::new(rotation::exp(&Vector3::new(0.0, 0.0, 2.4)), Vector3::new(120.0, -40.0, 7.0))
    }

    /// A drive round a corner, 60 m in 40 s, one reading a second, with errors of a standard deviation of 0.5 m.
    fn drive(seed: u64, outliers: usize) -> Vec<Located> {
        let mut rng = StdRng::seed_from_u64(seed);
        let mut normal = || (0..12).map(|_| rng.random_range(-0.5..0.5)).sum::<f64>();
        let at = |k: usize| {
            let s = 1.5 * k as f64;
            if s < 30.0 { Vector3::new(s, 0.0, 0.1) } else { Vector3::new(30.0, s - 30.0, 0.1) }
        };
        let one = |k: usize| Located {
            stamp_ns: k as i64 * 1_000_000_000,
            in_local: at(k),
            in_global: truth().transform(&at(k))
                + Vector3::new(normal(), normal(), normal()) * 0.5
                + Vector3::x() * if k % 7 == 3 && k / 7 < outliers { 9.0 } else { 0.0 },
            covariance: Matrix3::identity() * 0.25,
        };
        (0..40).map(one).collect()
    }

    fn known() -> PoseWithCovariance {
        PoseWithCovariance::new(Pose::identity(), Matrix6::identity() * 1e-12)
    }

    #[test]
    fn the_covariance_is_that_of_the_error() {
        let (mut sum, runs) = (0.0, 200);
        for seed in 0..runs {
            // Readings that are a second apart are independent where the correlation time is a tenth of it.
            let found = align(&drive(seed, 0), 0.1, 1e-3, &known()).unwrap();
            let error = local_error(&found.transform.pose, &truth());
            let sampled = error.fixed_rows::<4>(2).into_owned();
            let covariance = found.transform.covariance.fixed_view::<4, 4>(2, 2).into_owned();
            sum += sampled.dot(&(covariance.try_inverse().unwrap() * sampled)) / 4.0;
            assert!((0.003..0.03).contains(&found.sigma_yaw_rad), "{}", found.sigma_yaw_rad);
        }
        let nees = sum / runs as f64;
        assert!((0.8..1.15).contains(&nees), "{nees}");
    }

    #[test]
    fn outliers_are_left_out_and_too_many_are_refused() {
        let found = align(&drive(3, 4), 0.1, 1e-3, &known()).unwrap();
        assert!(local_error(&found.transform.pose, &truth()).norm() < 1.0);
        let mut bent = drive(3, 0);
        for one in bent.iter_mut().skip(15).step_by(2) {
            one.in_global.y += 15.0;
        }
        assert_eq!(align(&bent, 0.1, 1e-3, &known()).err(), Some(Unaligned::Misfit));
        assert_eq!(align(&drive(3, 0)[..4], 0.1, 1e-3, &known()).err(), Some(Unaligned::TooFew));
    }

    /// Another unit, exchanged axes and a receiver that repeats its last position.
    #[test]
    fn positions_that_do_not_follow_odometry_are_a_misfit() {
        let kinds: [fn(&mut Vector3<f64>); 3] =
            [|at| *at *= 1e-3, |at| at.swap_rows(0, 1), |at| *at = Vector3::new(1.0, 2.0, 3.0)];
        for kind in kinds {
            let mut wrong = drive(3, 0);
            for one in &mut wrong {
                kind(&mut one.in_global);
            }
            let found = align(&wrong, 0.1, 1e-3, &known());
            assert_eq!(found.err(), Some(Unaligned::Misfit));
        }
    }

    #[test]
    fn correlated_readings_are_worth_less() {
        let alone = align(&drive(1, 0), 0.01, 1e-6, &known()).unwrap();
        let alike = align(&drive(1, 0), 30.0, 1e-6, &known()).unwrap();
        let ratio = (alike.sigma_yaw_rad / alone.sigma_yaw_rad).powi(2);
        // One second of thirty: twice the correlation time counts as one reading.
        assert!((55.0..65.0).contains(&ratio), "{ratio}");
        assert!((inflation(30.0, 1.0) - 1.0).abs() < 1e-9);
    }

    #[test]
    fn a_robot_that_stands_knows_no_yaw() {
        let mut standing = drive(1, 0);
        for one in &mut standing {
            one.in_local = Vector3::zeros();
        }
        match align(&standing, 0.1, 1e-3, &known()) {
            Ok(found) => assert!(found.sigma_yaw_rad > 1.0),
            Err(why) => assert_eq!(why, Unaligned::TooFew),
        }
    }
}
