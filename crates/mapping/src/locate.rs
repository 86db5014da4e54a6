//! Where one landmark is, from poses that are uncertain: the start for the refinement of all.

use nalgebra::{Matrix2, Matrix3, Matrix6, Vector3};

use super::point::{CameraPose, Lens, MAX_DEPTH, Point, Sighting};
use super::tracks::Feature;
use super::views::View;

/// Nearest depth that is tried (m).
const NEAREST_TRIED: f64 = 0.3;
/// Number of depths that are tried, evenly in inverse depth's logarithm.
const TRIED: usize = 28;
/// Squared distance, in sigmas of pixels and poses together, beyond which a sighting is not of the point: chi-square
/// with 2 degrees of freedom, 0.3 %.
const GATE: f64 = 12.0;
/// Gauss-Newton steps after the best depth was found.
const STEPS: usize = 6;

/// Everything that locating needs besides the track.
pub(super) struct Scene<'a> {
    /// The cameras of all views.
    pub(super) rig: &'a [Lens],
    /// The views.
    pub(super) views: &'a [View<'a>],
    /// Their given poses.
    pub(super) poses: &'a [CameraPose],
    /// Standard deviation of a pixel (px).
    pub(super) sigma_px: f64,
}

/// Locates the landmark of a track, and drops sightings that cannot be of it.
///
/// The pixel of each view other than the anchor is weighted with what the covariances of both poses make of it, see
/// [`Scene::weight`]. The depth is searched on a grid first, with a bounded cost, so that a wrong sighting or an
/// unlucky pose does not decide.
///
/// # Returns
/// The landmark, anchored in the middle of its track, and the features that were dropped. `None` for the landmark
/// where not even two sightings agree.
pub(super) fn locate(scene: &Scene<'_>, track: &[Feature], least: usize) -> (Option<Point>, Vec<Feature>) {
    let sightings = scene.sightings(track);
    // The middle has the shortest way to all others.
    let (view, feature) = track[track.len() / 2];
    let in_middle = |sighting: &Sighting| sighting.feature == (view, feature);
    let (Some(anchor), Some(ray)) = (sightings.iter().position(in_middle), scene.views[view].rays[feature])
    else {
        return (None, Vec::new());
    };
    let start = Point { anchor, ray, inverse_depth: 1.0, sightings };
    let (point, _) = (0..TRIED)
        .map(|index| {
            let fraction = index as f64 / (TRIED - 1) as f64;
            let depth = NEAREST_TRIED * (MAX_DEPTH / NEAREST_TRIED).powf(fraction);
            let point = Point { inverse_depth: depth.recip(), ..start.clone() };
            let cost: f64 = distances(scene, &point).iter().map(|distance| distance.min(GATE)).sum();
            (point, cost)
        })
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .unwrap_or((start, 0.0));
    let point = refine(scene, point);
    let keep: Vec<bool> = distances(scene, &point).iter().map(|&distance| distance <= GATE).collect();
    let is_dropped = |(sighting, keep): &(&Sighting, &bool)| !**keep && sighting.lens == 0;
    let dropped = point.sightings.iter().zip(&keep).filter(is_dropped).map(|(s, _)| s.feature).collect();
    match point.retained(&keep, least) {
        Some(point) => (Some(refine(scene, point)), dropped),
        None => (None, Vec::new()),
    }
}

/// Squared distance of each sighting from its prediction, in sigmas; infinite where it cannot be seen.
fn distances(scene: &Scene<'_>, point: &Point) -> Vec<f64> {
    let distance = |(index, sighting): (usize, &Sighting)| {
        if index == point.anchor {
            let residual = sighting.pixel - point.predict_in_anchor(scene.rig).0;
            return residual.norm_squared() / (scene.sigma_px * scene.sigma_px);
        }
        scene.weight(point, sighting).map_or(f64::INFINITY, |(prediction, weight)| {
            let residual = sighting.pixel - prediction.pixel;
            residual.dot(&(weight * residual))
        })
    };
    point.sightings.iter().enumerate().map(distance).collect()
}

impl Scene<'_> {
    /// Where the views of a track saw it, with one camera or both.
    fn sightings(&self, track: &[Feature]) -> Vec<Sighting> {
        let of_feature = |&(view, feature): &Feature| {
            let first =
                Sighting { feature: (view, feature), lens: 0, pixel: self.views[view].pixel(feature) };
            let second =
                self.views[view].stereo_pixel(feature).map(|pixel| Sighting { lens: 1, pixel, ..first });
            std::iter::once(first).chain(second)
        };
        track.iter().flat_map(of_feature).collect()
    }

    /// Prediction of a point in a view, and the inverse of its covariance from the pixel and both poses (2x2):
    /// `sigma^2 I + J_a P_a J_a^T + J_v P_v J_v^T`.
    fn weight(&self, point: &Point, sighting: &Sighting) -> Option<(super::point::Prediction, Matrix2<f64>)> {
        let (anchor, view) = (point.anchor_view(), sighting.view());
        let prediction = point.predict(self.rig, self.poses, sighting)?;
        let covariance = |view: usize| -> &Matrix6<f64> { &self.views[view].prior.covariance };
        let total = Matrix2::identity() * (self.sigma_px * self.sigma_px)
            + prediction.by_anchor * covariance(anchor) * prediction.by_anchor.transpose()
            + prediction.by_view * covariance(view) * prediction.by_view.transpose();
        let weight = total.try_inverse()?;
        Some((prediction, weight))
    }
}

/// Gauss-Newton on ray and inverse depth with the poses held, sightings beyond the gate left out.
fn refine(scene: &Scene<'_>, mut point: Point) -> Point {
    for _ in 0..STEPS {
        let mut information = Matrix3::zeros();
        let mut gradient = Vector3::zeros();
        let anchor_weight = (scene.sigma_px * scene.sigma_px).recip();
        let (pixel, by_ray) = point.predict_in_anchor(scene.rig);
        let residual = point.sightings[point.anchor].pixel - pixel;
        let ray_information = by_ray.transpose() * by_ray * anchor_weight;
        let ray_gradient = by_ray.transpose() * residual * anchor_weight;
        information.fixed_view_mut::<2, 2>(0, 0).copy_from(&ray_information);
        gradient.fixed_rows_mut::<2>(0).copy_from(&ray_gradient);
        for (index, sighting) in point.sightings.iter().enumerate() {
            if index == point.anchor {
                continue;
            }
            let Some((prediction, weight)) = scene.weight(&point, sighting) else { continue };
            let residual = sighting.pixel - prediction.pixel;
            if residual.dot(&(weight * residual)) <= GATE {
                information += prediction.by_point.transpose() * weight * prediction.by_point;
                gradient += prediction.by_point.transpose() * (weight * residual);
            }
        }
        // A weak hold on the inverse depth (sigma 1/m), for points without parallax.
        information[(2, 2)] += 1.0;
        let Some(factor) = information.cholesky() else { break };
        point = point.moved(&factor.solve(&gradient));
    }
    point
}
