//! Consistency: whether errors are as large as the covariance says (NEES, 1 a degree of freedom is right).

use geometry::pose::Pose;
use geometry::uncertain_pose::PoseWithCovariance;
use nalgebra::{Matrix3, SMatrix, SVector};
use serde::Serialize;
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Normalized estimation error squared of one pose, per degree of freedom.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Nees {
    /// Of the rotation (3 degrees of freedom).
    pub rotation: f64,
    /// Of the position (3).
    pub position: f64,
    /// Of both together (6).
    pub pose: f64,
}

/// NEES of an estimate: `e^T P^-1 e / n` with the error `[dtheta, dp]` of the parent frame.
///
/// `None` where the covariance is not positive definite: an estimate that claims to be exact is never consistent.
pub fn nees(estimate: &PoseWithCovariance, truth: &Pose) -> Option<Nees> {
    let error = estimate.pose.local(truth);
    let block =
        |start: usize| -> Matrix3<f64> { estimate.covariance.fixed_view::<3, 3>(start, start).into() };
    Some(Nees {
        rotation: quadratic_form(&block(0), &error.fixed_rows::<3>(0).into())? / 3.0,
        position: quadratic_form(&block(3), &error.fixed_rows::<3>(3).into())? / 3.0,
        pose: quadratic_form(&estimate.covariance, &error)? / 6.0,
    })
}

fn quadratic_form<const N: usize>(covariance: &SMatrix<f64, N, N>, error: &SVector<f64, N>) -> Option<f64> {
    let factor = covariance.cholesky()?;
    let value = factor.l().solve_lower_triangular(error)?.norm_squared();
    value.is_finite().then_some(value)
}

/// Mean of many [`Nees`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NeesSum {
    rotation: f64,
    position: f64,
    pose: f64,
    samples: usize,
}

impl NeesSum {
    /// Adds one.
    pub fn push(&mut self, nees: &Nees) {
        self.rotation += nees.rotation;
        self.position += nees.position;
        self.pose += nees.pose;
        self.samples += 1;
    }

    /// How many were added.
    pub fn samples(&self) -> usize {
        self.samples
    }

    /// Their mean, `None` without any.
    pub fn mean(&self) -> Option<Nees> {
        let count = self.samples as f64;
        (self.samples > 0).then(|| Nees {
            rotation: self.rotation / count,
            position: self.position / count,
            pose: self.pose / count,
        })
    }
}

/// Between which bounds the mean NEES per degree of freedom of a consistent estimator lies.
///
/// # Arguments
/// * `degrees_of_freedom`: of one sample, 3 or 6 here.
/// * `samples`: how many *independent* ones were averaged; successive poses of one run are anything but.
/// * `confidence`: for example 0.95.
///
/// # Returns
/// Lower and upper bound, `None` where an argument makes no sense.
///
/// Source: Bar-Shalom, Li, Kirubarajan, *Estimation with Applications to Tracking and Navigation*, section 5.4.
pub fn nees_bounds(degrees_of_freedom: usize, samples: usize, confidence: f64) -> Option<(f64, f64)> {
    if !(confidence > 0.0 && confidence < 1.0) {
        return None;
    }
    let total = (degrees_of_freedom * samples) as f64;
    let distribution = ChiSquared::new(total).ok()?;
    let tail = (1.0 - confidence) / 2.0;
    Some((distribution.inverse_cdf(tail) / total, distribution.inverse_cdf(1.0 - tail) / total))
}
