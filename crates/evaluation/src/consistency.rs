//! Consistency of a pose with its covariance: the NEES per degree of freedom, whose expectation is 1.

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
/// # Returns
/// `None` where the covariance is not positive definite: an estimate that claims to be exact is never consistent.
///
/// ```
/// use evaluation::nees;
/// use geometry::{Pose, PoseWithCovariance};
/// use nalgebra::{Matrix6, UnitQuaternion, Vector3};
///
/// // A standard deviation of 0.1 (rad and m) on each axis, and a position that is off by 0.2 m along x.
/// let estimate = PoseWithCovariance::new(Pose::identity(), Matrix6::identity() * 0.01);
/// let truth = Pose::new(UnitQuaternion::identity(), Vector3::new(0.2, 0.0, 0.0));
/// let nees = nees(&estimate, &truth).expect("the covariance is positive definite");
/// assert!((nees.position - 4.0 / 3.0).abs() < 1e-12 && nees.rotation == 0.0);
/// ```
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

    /// Number of samples.
    pub fn samples(&self) -> usize {
        self.samples
    }

    /// The mean; `None` without samples.
    pub fn mean(&self) -> Option<Nees> {
        let count = self.samples as f64;
        (self.samples > 0).then(|| Nees {
            rotation: self.rotation / count,
            position: self.position / count,
            pose: self.pose / count,
        })
    }
}

/// The interval in which the mean NEES per degree of freedom of a consistent estimator lies.
///
/// # Arguments
/// * `degrees_of_freedom`: of one sample, 3 or 6 here.
/// * `samples`: number of *independent* samples in the mean; successive poses of one run are correlated.
/// * `confidence`: for example 0.95.
///
/// # Returns
/// Lower and upper bound; `None` for no samples or degrees of freedom, or a confidence outside of (0, 1).
///
/// Source: Bar-Shalom, Li, Kirubarajan, *Estimation with Applications to Tracking and Navigation*, section 5.4.
///
/// ```
/// let (low, high) = evaluation::nees_bounds(6, 20, 0.95).expect("valid arguments");
/// assert!(low < 1.0 && 1.0 < high);
/// ```
pub fn nees_bounds(degrees_of_freedom: usize, samples: usize, confidence: f64) -> Option<(f64, f64)> {
    if !(confidence > 0.0 && confidence < 1.0) {
        return None;
    }
    let total = (degrees_of_freedom * samples) as f64;
    let distribution = ChiSquared::new(total).ok()?;
    let tail = (1.0 - confidence) / 2.0;
    Some((distribution.inverse_cdf(tail) / total, distribution.inverse_cdf(1.0 - tail) / total))
}
