//! Correction of the IMU's state by a measurement update, compared with its expectation.
//!
//! The correction of an optimal filter has the covariance `P⁻ - P⁺`. The noise that is added between two images is observed
//! by the second, so in the steady state `P⁻ - P⁺` is that noise.

use crate::covariance::JointCovariance;
use crate::propagation::{ImuState, VELOCITY};
use nalgebra::{Matrix3, Vector3};

/// Regularization of `P⁻ - P⁺`, relative to its trace: a direction that was not corrected shows nothing.
const RIDGE: f64 = 1e-9;

/// Rotation and velocity of the IMU with their covariances before an update.
#[derive(Clone, Debug)]
pub struct BeforeUpdate {
    imu: ImuState,
    rotation: Matrix3<f64>,
    velocity: Matrix3<f64>,
}

impl BeforeUpdate {
    /// What an update will be compared with.
    pub fn of(imu: &ImuState, covariance: &JointCovariance) -> Self {
        Self { imu: *imu, rotation: block(covariance, 0), velocity: block(covariance, VELOCITY) }
    }

    /// Squared corrections of rotation and velocity for each degree of freedom, in units of their expectation.
    ///
    /// # Returns
    /// `None` where nothing was corrected.
    pub fn ratios(&self, imu: &ImuState, covariance: &JointCovariance) -> [Option<f64>; 2] {
        let rotation = self.imu.local_from_imu.local(&imu.local_from_imu).fixed_rows::<3>(0).into_owned();
        let velocity = imu.velocity - self.imu.velocity;
        [
            ratio(&rotation, &(self.rotation - block(covariance, 0))),
            ratio(&velocity, &(self.velocity - block(covariance, VELOCITY))),
        ]
    }
}

fn block(covariance: &JointCovariance, begin: usize) -> Matrix3<f64> {
    covariance.active().view().fixed_view::<3, 3>(begin, begin).into_owned()
}

fn ratio(correction: &Vector3<f64>, covariance: &Matrix3<f64>) -> Option<f64> {
    let regularized = covariance + Matrix3::identity() * (RIDGE * covariance.trace());
    Some(correction.dot(&regularized.cholesky()?.solve(correction)) / 3.0)
}
