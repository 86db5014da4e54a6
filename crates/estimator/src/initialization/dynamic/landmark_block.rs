//! What all sightings of one landmark say of it and of the poses that saw it.

use super::adjustment::{Entry, Loss, Settings};
use super::landmark;
use super::window::StartSighting;
use crate::propagation::ImuState;
use nalgebra::{Matrix3, Matrix3x6, Matrix6, Vector3, Vector6};

/// Cost of a sighting that has no pixel at an estimate: that of a gross outlier, in half squared sigmas.
const NO_PIXEL_COST: f64 = 50.0;
/// Information of an inverse depth beside its sightings', m^2: a landmark without any parallax stays solvable.
const WEAK_INFORMATION: f64 = 1e-2;

/// The part of one image.
#[derive(Clone, Copy, Debug)]
pub struct PoseBlock {
    /// Place of the image in the window.
    pub image: usize,
    /// Landmark by pose.
    pub cross: Matrix3x6<f64>,
    /// Right side.
    pub vector: Vector6<f64>,
}

/// The normal equations of one landmark.
#[derive(Clone, Debug)]
pub struct LandmarkBlock {
    /// Landmark by landmark.
    pub own: Matrix3<f64>,
    /// Right side.
    pub vector: Vector3<f64>,
    /// The images that saw it.
    pub poses: Vec<PoseBlock>,
    /// Pose by pose, where row is not before column: a sighting connects two images.
    pub squares: Vec<(usize, usize, Matrix6<f64>)>,
}

impl LandmarkBlock {
    /// Linearizes the sightings that are believed.
    pub fn new(settings: &Settings<'_>, states: &[ImuState], entry: &Entry, loss: Loss) -> Self {
        let mut block =
            Self { own: Matrix3::zeros(), vector: Vector3::zeros(), poses: Vec::new(), squares: Vec::new() };
        block.own.m33 = WEAK_INFORMATION;
        let sigma = settings.config.sigma_track_px;
        let anchor = &settings.window.tracks[entry.track][0];
        for sighting in believed(settings, entry) {
            let row = landmark::linearize(&entry.landmark, anchor, sighting, states, settings.rig);
            let Some(row) = row else { continue };
            let weight = loss.weight(row.residual.norm() / sigma) / sigma.powi(2);
            let (old, new) = if sighting.image == anchor.image {
                (None, row.by_anchor + row.by_body)
            } else {
                (Some(row.by_anchor), row.by_body)
            };
            for (image, by_pose) in
                old.map(|old| (anchor.image, old)).into_iter().chain([(sighting.image, new)])
            {
                let weighted = by_pose.transpose() * weight;
                block.add_pose(
                    image,
                    row.by_landmark.transpose() * weighted.transpose(),
                    weighted * row.residual,
                );
                block.add_square(image, image, &(weighted * by_pose));
            }
            if let Some(old) = old {
                block.add_square(sighting.image, anchor.image, &(new.transpose() * old * weight));
            }
            block.own += row.by_landmark.transpose() * row.by_landmark * weight;
            block.vector += row.by_landmark.transpose() * row.residual * weight;
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

fn believed<'a>(settings: &'a Settings<'_>, entry: &'a Entry) -> impl Iterator<Item = &'a StartSighting> {
    let track = &settings.window.tracks[entry.track];
    track.iter().zip(&entry.used).filter(|(_, used)| **used).map(|(sighting, _)| sighting)
}

/// Half the sum of squares of the sightings that are believed, in sigmas, the loss applied.
pub fn landmark_cost(settings: &Settings<'_>, states: &[ImuState], entry: &Entry, loss: Loss) -> f64 {
    let anchor = &settings.window.tracks[entry.track][0];
    let cost = |sighting| {
        landmark::residual(&entry.landmark, anchor, sighting, states, settings.rig)
            .map_or(NO_PIXEL_COST, |residual| loss.cost(residual.norm() / settings.config.sigma_track_px))
    };
    believed(settings, entry).map(cost).sum()
}
