//! The normal equations of one landmark and the poses that observe it.

use super::problem::{Loss, Problem, WindowLandmark};
use super::reprojection;
use crate::propagation::ImuState;
use nalgebra::{Matrix3, Matrix3x6, Matrix6, Vector3, Vector6};

/// Cost of an observation whose landmark does not project: that of a gross outlier, in half squared sigmas.
const NO_PIXEL_COST: f64 = 50.0;
/// Prior information of an inverse depth, m^2: a landmark without parallax stays solvable.
const WEAK_INFORMATION: f64 = 1e-2;

/// The blocks of one image.
#[derive(Clone, Copy, Debug)]
pub struct PoseBlock {
    /// Index of the image in the window.
    pub image: usize,
    /// Landmark by pose.
    pub cross: Matrix3x6<f64>,
    /// Right-hand side.
    pub vector: Vector6<f64>,
}

/// The normal equations of one landmark.
#[derive(Clone, Debug)]
pub struct LandmarkBlock {
    /// Landmark by landmark.
    pub own: Matrix3<f64>,
    /// Right-hand side.
    pub vector: Vector3<f64>,
    /// The images that observe it.
    pub poses: Vec<PoseBlock>,
    /// Pose by pose, row not before column: an observation connects two images.
    pub squares: Vec<(usize, usize, Matrix6<f64>)>,
}

impl LandmarkBlock {
    /// Linearizes the inliers.
    pub fn new(problem: &Problem<'_>, states: &[ImuState], landmark: &WindowLandmark, loss: Loss) -> Self {
        let mut block =
            Self { own: Matrix3::zeros(), vector: Vector3::zeros(), poses: Vec::new(), squares: Vec::new() };
        block.own.m33 = WEAK_INFORMATION;
        let sigma = problem.config.sigma_track_px;
        let anchor = &problem.window.tracks[landmark.track][0];
        for observation in problem.inliers(landmark) {
            let linearized =
                reprojection::linearize(&landmark.position, anchor, observation, states, problem.cameras);
            let Some(row) = linearized else { continue };
            let weight = loss.weight(row.residual.norm() / sigma) / sigma.powi(2);
            let (old, new) = if observation.image == anchor.image {
                (None, row.wrt_anchor + row.wrt_body)
            } else {
                (Some(row.wrt_anchor), row.wrt_body)
            };
            for (image, wrt_pose) in
                old.map(|old| (anchor.image, old)).into_iter().chain([(observation.image, new)])
            {
                let weighted = wrt_pose.transpose() * weight;
                block.add_pose(
                    image,
                    row.wrt_landmark.transpose() * weighted.transpose(),
                    weighted * row.residual,
                );
                block.add_square(image, image, &(weighted * wrt_pose));
            }
            if let Some(old) = old {
                block.add_square(observation.image, anchor.image, &(new.transpose() * old * weight));
            }
            block.own += row.wrt_landmark.transpose() * row.wrt_landmark * weight;
            block.vector += row.wrt_landmark.transpose() * row.residual * weight;
        }
        block
    }

    fn add_pose(&mut self, image: usize, cross: Matrix3x6<f64>, vector: Vector6<f64>) {
        if let Some(known) = self.poses.iter_mut().find(|known| known.image == image) {
            known.cross += cross;
            known.vector += vector;
        } else {
            self.poses.push(PoseBlock { image, cross, vector });
        }
    }

    fn add_square(&mut self, row: usize, column: usize, square: &Matrix6<f64>) {
        match self.squares.iter_mut().find(|known| (known.0, known.1) == (row, column)) {
            Some(known) => known.2 += square,
            None => self.squares.push((row, column, *square)),
        }
    }

    /// Covariance of the landmark for exact poses.
    pub fn inverse(&self) -> Option<Matrix3<f64>> {
        self.own.try_inverse()
    }

    /// The step of the landmark for exact poses.
    pub fn solve(&self) -> Option<Vector3<f64>> {
        self.inverse().map(|inverse| inverse * self.vector)
    }
}

/// Cost of the inliers: half the sum of squares in sigmas, with the loss applied.
pub fn landmark_cost(
    problem: &Problem<'_>,
    states: &[ImuState],
    landmark: &WindowLandmark,
    loss: Loss,
) -> f64 {
    let anchor = &problem.window.tracks[landmark.track][0];
    let cost = |observation| {
        reprojection::residual(&landmark.position, anchor, observation, states, problem.cameras)
            .map_or(NO_PIXEL_COST, |residual| loss.cost(residual.norm() / problem.config.sigma_track_px))
    };
    problem.inliers(landmark).map(cost).sum()
}
