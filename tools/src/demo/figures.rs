//! The figures of one variant, over the instants of all of its runs.

use evaluation::{ErrorSample, NeesSum};
use serde::Serialize;

/// Error, claimed uncertainty and consistency of one of the three poses.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Figures {
    /// Root mean square of the rotation error, degrees.
    pub rmse_deg: f64,
    /// Root mean square of the position error, metres.
    pub rmse_m: f64,
    /// Standard deviation of the rotation by the filter's own covariance, root mean square, degrees. Comparable with
    /// `rmse_deg`: all three axes together.
    pub sigma_deg: f64,
    /// The same of the position, metres.
    pub sigma_m: f64,
    /// Mean NEES of the pose per degree of freedom; 1 is consistent. `None` where no covariance was positive definite.
    pub nees_pose: Option<f64>,
    /// Number of instants.
    pub samples: usize,
}

/// Sums of the errors of one pose.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct FigureSums {
    /// Squares: rotation error, position error, rotation sigma, position sigma.
    squares: [f64; 4],
    nees: NeesSum,
    samples: usize,
}

impl FigureSums {
    /// Adds the errors of a run.
    pub(super) fn add<'a>(&mut self, samples: impl IntoIterator<Item = &'a ErrorSample>) {
        for sample in samples {
            let norm_squared =
                |vector: &nalgebra::Vector6<f64>, first: usize| vector.fixed_rows::<3>(first).norm_squared();
            let squares = [
                norm_squared(&sample.error, 0),
                norm_squared(&sample.error, 3),
                norm_squared(&sample.sigma, 0),
                norm_squared(&sample.sigma, 3),
            ];
            for (sum, square) in self.squares.iter_mut().zip(squares) {
                *sum += square;
            }
            if let Some(nees) = &sample.nees {
                self.nees.push(nees);
            }
            self.samples += 1;
        }
    }

    /// The figures; `None` without any errors.
    pub(super) fn figures(&self) -> Option<Figures> {
        let [rotation, position, sigma_rotation, sigma_position] =
            self.squares.map(|sum| (sum / self.samples as f64).sqrt());
        (self.samples > 0).then(|| Figures {
            rmse_deg: rotation.to_degrees(),
            rmse_m: position,
            sigma_deg: sigma_rotation.to_degrees(),
            sigma_m: sigma_position,
            nees_pose: self.nees.mean().map(|nees| nees.pose),
            samples: self.samples,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use evaluation::nees;
    use geometry::{Pose, PoseWithCovariance};
    use nalgebra::{Matrix6, Vector3, Vector6};

    #[test]
    fn a_position_error_of_one_sigma_an_axis_equals_the_claimed_sigma() {
        let truth = Pose::new(nalgebra::UnitQuaternion::identity(), Vector3::new(0.1, -0.1, 0.1));
        let estimate = PoseWithCovariance::new(Pose::identity(), Matrix6::identity() * 0.01);
        let error = Vector6::new(0.0, 0.0, 0.0, 0.1, -0.1, 0.1);
        let sigma = Vector6::repeat(0.1);
        let sample = ErrorSample { stamp_ns: 0, error, sigma, nees: nees(&estimate, &truth) };
        let mut sums = FigureSums::default();
        assert!(sums.figures().is_none());
        sums.add([&sample, &sample]);
        let figures = sums.figures().unwrap();
        assert!((figures.rmse_m - figures.sigma_m).abs() < 1e-12 && figures.rmse_deg == 0.0);
        assert!((figures.nees_pose.unwrap() - 0.5).abs() < 1e-12, "three of six axes are one sigma off");
        assert_eq!(figures.samples, 2);
    }
}
