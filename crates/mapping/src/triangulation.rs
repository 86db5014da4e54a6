//! Triangulation of one landmark from uncertain poses: the initial value for bundle adjustment.

use adjustment::{
    InverseDepthLandmark, LandmarkObservation, MAPPED_INVERSE_DEPTHS, MAX_DEPTH, Prediction, ViewPose,
};
use nalgebra::{Matrix2, Matrix3, Matrix6, Vector3};

use super::camera::Rig;
use super::correlations::Correlations;
use super::keyframe_view::{FeatureId, KeyframeView};

/// Smallest depth of the grid (m): indoor cameras see surfaces this near.
const GRID_MIN_DEPTH: f64 = 0.3;
/// Number of depths of the grid, uniform in the logarithm: neighbours differ by a third.
const GRID_SIZE: usize = 28;
/// Mahalanobis distance squared, from the noise of pixels and poses, beyond which an observation is an outlier:
/// chi-square with 2 degrees of freedom, 0.3 %.
const GATE: f64 = 12.0;
/// Gauss-Newton iterations from the best depth of the grid, which is close enough for quadratic convergence.
const STEPS: usize = 6;

/// Input of triangulation besides the track.
pub(super) struct Scene<'a> {
    /// The cameras.
    pub(super) rig: &'a Rig,
    /// The keyframes.
    pub(super) views: &'a [KeyframeView<'a>],
    /// Their reference poses.
    pub(super) poses: &'a [ViewPose],
    /// How their errors are correlated.
    pub(super) correlations: &'a Correlations<'a>,
    /// Standard deviation of a pixel (px).
    pub(super) sigma_px: f64,
}

/// Triangulates the landmark of a track, and drops outlier observations.
///
/// The pixel of each view other than the anchor is weighted with what the covariances of both poses make of it, see
/// [`Scene::weight`]. The depth is searched on a grid first, with a truncated cost, which is robust to
/// outliers and to single poses with large errors.
///
/// # Returns
/// The landmark, anchored in the middle of its track, and the features that were dropped. `None` for the landmark
/// where fewer than two observations agree.
pub(super) fn triangulate(
    scene: &Scene<'_>,
    track: &[FeatureId],
    least: usize,
) -> (Option<InverseDepthLandmark>, Vec<FeatureId>) {
    let observations = scene.observations(track);
    // The middle is closest to all others.
    let (view, feature) = track[track.len() / 2];
    let in_middle = |observation: &LandmarkObservation| observation.feature == (view, feature);
    let (Some(anchor), Some(ray)) =
        (observations.iter().position(in_middle), scene.views[view].rays[feature])
    else {
        return (None, Vec::new());
    };
    let mut landmark = InverseDepthLandmark { anchor, ray, inverse_depth: 1.0, observations, prior: None };
    let (mut best, mut least_cost) = (1.0, f64::INFINITY);
    for index in 0..GRID_SIZE {
        let fraction = index as f64 / (GRID_SIZE - 1) as f64;
        let depth = GRID_MIN_DEPTH * (MAX_DEPTH / GRID_MIN_DEPTH).powf(fraction);
        landmark.inverse_depth = depth.recip();
        if let Some(cost) = cost_below(scene, &landmark, least_cost) {
            (best, least_cost) = (landmark.inverse_depth, cost);
        }
    }
    landmark.inverse_depth = best;
    let landmark = refine(scene, landmark);
    let keep: Vec<bool> = distances(scene, &landmark).iter().map(|&distance| distance <= GATE).collect();
    let is_dropped = |(observation, keep): &(&LandmarkObservation, &bool)| !**keep && !observation.is_second;
    let dropped =
        landmark.observations.iter().zip(&keep).filter(is_dropped).map(|(s, _)| s.feature).collect();
    match landmark.retained(&keep, least) {
        Some(landmark) => (Some(refine(scene, landmark)), dropped),
        None => (None, Vec::new()),
    }
}

/// Sum of the squared distances of all observations, each truncated; `None` where it is not below a limit.
fn cost_below(scene: &Scene<'_>, landmark: &InverseDepthLandmark, limit: f64) -> Option<f64> {
    let mut cost = 0.0;
    for index in 0..landmark.observations.len() {
        cost += scene.distance(landmark, index).min(GATE);
        if cost >= limit {
            return None;
        }
    }
    Some(cost)
}

/// Squared distance of each observation from its prediction, in sigmas; infinite where it is not visible.
fn distances(scene: &Scene<'_>, landmark: &InverseDepthLandmark) -> Vec<f64> {
    (0..landmark.observations.len()).map(|index| scene.distance(landmark, index)).collect()
}

impl Scene<'_> {
    /// The observations of a track, each by one camera or both of a stereo pair.
    fn observations(&self, track: &[FeatureId]) -> Vec<LandmarkObservation> {
        let of_feature =
            |&(view, feature): &FeatureId| self.rig.observations((view, feature), &self.views[view]);
        track.iter().flat_map(of_feature).collect()
    }

    /// Squared distance of an observation from its prediction, in sigmas; infinite where it is not visible.
    fn distance(&self, landmark: &InverseDepthLandmark, index: usize) -> f64 {
        self.weight(landmark, index).map_or(f64::INFINITY, |(prediction, weight)| {
            let residual = landmark.observations[index].pixel - prediction.pixel;
            residual.dot(&(weight * residual))
        })
    }

    /// Prediction of a landmark in a view, and the inverse of its covariance from the pixel and both poses (2x2):
    /// `sigma^2 I + J_a P_a J_a^T + J_v P_v J_v^T + J_a P_av J_v^T + J_v P_av^T J_a^T`.
    fn weight(&self, landmark: &InverseDepthLandmark, index: usize) -> Option<(Prediction, Matrix2<f64>)> {
        let (anchor, view) = (landmark.anchor_view(), landmark.observations[index].view());
        let prediction = landmark.predict(&self.rig.cameras, self.poses, index)?;
        let covariance = |view: usize| -> &Matrix6<f64> { &self.views[view].prior.covariance };
        let mut total = Matrix2::identity() * (self.sigma_px * self.sigma_px)
            + prediction.by_anchor * covariance(anchor) * prediction.by_anchor.transpose()
            + prediction.by_view * covariance(view) * prediction.by_view.transpose();
        if let Some(cross) = (anchor != view).then(|| self.correlations.between(anchor, view)).flatten() {
            let of_both = prediction.by_anchor * cross * prediction.by_view.transpose();
            total += of_both + of_both.transpose();
        }
        let weight = total.try_inverse()?;
        Some((prediction, weight))
    }
}

/// Gauss-Newton on ray and inverse depth with the poses held, observations beyond the gate left out.
fn refine(scene: &Scene<'_>, mut landmark: InverseDepthLandmark) -> InverseDepthLandmark {
    for _ in 0..STEPS {
        let mut information = Matrix3::zeros();
        let mut gradient = Vector3::zeros();
        for (index, observation) in landmark.observations.iter().enumerate() {
            let Some((prediction, weight)) = scene.weight(&landmark, index) else { continue };
            let residual = observation.pixel - prediction.pixel;
            if index == landmark.anchor || residual.dot(&(weight * residual)) <= GATE {
                information += prediction.by_landmark.transpose() * weight * prediction.by_landmark;
                gradient += prediction.by_landmark.transpose() * (weight * residual);
            }
        }
        // A weak prior on the inverse depth (sigma 1/m), for landmarks without parallax.
        information[(2, 2)] += 1.0;
        let Some(factor) = information.cholesky() else { break };
        landmark = landmark.corrected(&factor.solve(&gradient), MAPPED_INVERSE_DEPTHS);
    }
    landmark
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::correlations::tests::Neighbours;
    use nalgebra::Vector2;
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};
    use rand_distr::StandardNormal;

    /// The squared distance of an observation, with the pose errors that a map states and pixel noise, is chi-square with 2 degrees of
    /// freedom.
    #[test]
    fn reprojections_are_weighted_with_the_relative_covariance_of_correlated_poses() {
        const SAMPLES: usize = 4000;
        let mut rng = StdRng::seed_from_u64(9);
        let neighbours = Neighbours::new(&mut rng);
        let rig = Rig::of_single(vec![testing::camera()]);
        let point = Vector3::new(-0.6, 0.3, 4.0);
        let sigma_px = 0.8;
        let in_cameras = neighbours.truth.map(|pose| pose.inverse_transform(&point));
        let pixels = in_cameras.map(|point| rig.camera(0).project(&point).unwrap());
        let mut mean_square = |correlations: &Correlations<'_>| {
            let mut sum = 0.0;
            for _ in 0..SAMPLES {
                let view = |prior| KeyframeView {
                    stamp_ns: 0,
                    images: Vec::new(),
                    tracked: Vec::new(),
                    stereo: Vec::new(),
                    rays: Vec::new(),
                    prior,
                };
                let views = neighbours.sample(&mut rng).map(view);
                let poses: Vec<ViewPose> =
                    views.iter().map(|view| ViewPose::from(&view.prior.pose)).collect();
                let scene = Scene { rig: &rig, views: &views, poses: &poses, correlations, sigma_px };
                let noise = sigma_px * Vector2::from_fn(|_, _| rng.sample::<f64, _>(StandardNormal));
                let observation = |view: usize, pixel| LandmarkObservation {
                    feature: (view, 0),
                    camera: 0,
                    is_second: false,
                    pixel,
                };
                let landmark = InverseDepthLandmark {
                    anchor: 0,
                    ray: in_cameras[0].xy() / in_cameras[0].z,
                    inverse_depth: in_cameras[0].z.recip(),
                    observations: vec![observation(0, pixels[0]), observation(1, pixels[1] + noise)],
                    prior: None,
                };
                sum += distances(&scene, &landmark)[1];
            }
            sum / SAMPLES as f64
        };
        let mean = mean_square(&neighbours.correlations());
        // Of 4,000 samples the mean has a standard deviation of 0.032.
        assert!((1.85..2.15).contains(&mean), "{mean}");
        let mean = mean_square(&Correlations::Independent);
        assert!(mean < 1.0, "{mean}");
    }
}
