//! Pairs of keyframes to match, and the matches of each pair.

use std::collections::BTreeSet;

use geometry::camera::Camera;
use nalgebra::{Matrix3, Vector2, Vector3};
use vision::MatchOptions;

use super::error::BuildError;
use super::keyframe_view::KeyframeView;
use super::options::BuildOptions;

/// Images whose optical axes differ by more than this are not matched with neighbours in time (rad).
const MAX_ANGLE_IN_TIME: f64 = 1.2;
/// The same for neighbours in space: descriptors do not survive much more (rad).
const MAX_ANGLE_IN_SPACE: f64 = 0.8;
/// Keyframes further apart than this are no neighbours in space (m).
const MAX_DISTANCE_IN_SPACE: f64 = 10.0;
/// A match is dropped when it is this many sigmas from its epipolar plane, sigma with the poses' uncertainty.
const EPIPOLAR_GATE: f64 = 3.5;

/// Two features of two keyframes with similar descriptors that satisfy the epipolar constraint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct FeatureMatch {
    /// Index of the first view and its feature.
    pub(super) first: (usize, usize),
    /// Index of the second view and its feature.
    pub(super) second: (usize, usize),
    /// Descriptor distance.
    pub(super) distance: f32,
}

/// Pairs of keyframes that are near in time, each with the smaller index first.
pub(super) fn pairs_in_time(views: &[KeyframeView<'_>], options: &BuildOptions) -> Vec<(usize, usize)> {
    let of_view = |i: usize| {
        let near_in_time = (i + 1)..(i + 1 + options.time_neighbours).min(views.len());
        let same_direction = move |j: &usize| views[i].axis().angle(&views[*j].axis()) <= MAX_ANGLE_IN_TIME;
        near_in_time.filter(same_direction).map(move |j| (i, j))
    };
    let both_have_features = |&(i, j): &(usize, usize)| views[i].is_keyframe() && views[j].is_keyframe();
    (0..views.len()).flat_map(of_view).filter(both_have_features).collect()
}

/// The pairs of keyframes to match, in time and in space, each with the smaller index first.
pub(super) fn pairs(views: &[KeyframeView<'_>], options: &BuildOptions) -> Vec<(usize, usize)> {
    let mut pairs: BTreeSet<(usize, usize)> = pairs_in_time(views, options).into_iter().collect();
    for (i, view) in views.iter().enumerate().filter(|(_, view)| view.is_keyframe()) {
        let mut near_in_space: Vec<(f64, usize)> = (0..views.len())
            .filter(|&j| j.abs_diff(i) > options.time_neighbours && views[j].is_keyframe())
            .filter_map(|j| Some((spatial_distance(view, &views[j])?, j)))
            .collect();
        near_in_space.sort_by(|a, b| a.0.total_cmp(&b.0));
        pairs.extend(near_in_space.iter().take(options.space_neighbours).map(|&(_, j)| (i.min(j), i.max(j))));
    }
    pairs.into_iter().collect()
}

/// Distance measure of two views from position and direction, `None` for views that hardly overlap.
fn spatial_distance(a: &KeyframeView<'_>, b: &KeyframeView<'_>) -> Option<f64> {
    let distance = (a.prior.pose.translation - b.prior.pose.translation).norm();
    let angle = if distance <= MAX_DISTANCE_IN_SPACE { a.axis().angle(&b.axis()) } else { f64::INFINITY };
    (angle <= MAX_ANGLE_IN_SPACE).then_some(distance / MAX_DISTANCE_IN_SPACE + angle / MAX_ANGLE_IN_SPACE)
}

/// Matches two keyframes: nearest descriptors in both directions with a ratio test, then the epipolar constraint.
pub(super) fn match_pair(
    camera: &Camera,
    views: &[KeyframeView<'_>],
    (i, j): (usize, usize),
    sigma_px: f64,
    options: &BuildOptions,
) -> Result<Vec<FeatureMatch>, BuildError> {
    let (a, b) = (views[i].descriptors()?, views[j].descriptors()?);
    let mut settings = MatchOptions::for_metric(a.metric());
    settings.max_distance = options.max_descriptor_distance.unwrap_or(settings.max_distance);
    let matches = vision::match_descriptors(a, b, &settings)?;
    let possible = |found: &vision::Match| {
        epipolar_error(camera, [&views[i], &views[j]], [found.query, found.train], sigma_px)
            .is_some_and(|sigmas| sigmas <= EPIPOLAR_GATE)
    };
    Ok(matches
        .iter()
        .filter(|found| possible(found))
        .map(|found| FeatureMatch {
            first: (i, found.query),
            second: (j, found.train),
            distance: found.distance,
        })
        .collect())
}

/// Epipolar error of two rays, in standard deviations from the noise of pixels and poses. `None` without rays.
///
/// ```text
/// e = c . (d1 x d2),   c = p2 - p1,   d = R [alpha, beta, 1]        (the volume that the three vectors span)
/// de/dp2 = d1 x d2 = -de/dp1,   de/dtheta1 = d1 x (d2 x c),   de/dtheta2 = d2 x (c x d1)
/// ```
fn epipolar_error(
    camera: &Camera,
    views: [&KeyframeView<'_>; 2],
    features: [usize; 2],
    sigma_px: f64,
) -> Option<f64> {
    let rotation = views.map(|view| view.prior.pose.rotation.to_rotation_matrix().into_inner());
    let rays = [views[0].rays[features[0]]?, views[1].rays[features[1]]?];
    let d = [rotation[0] * rays[0].push(1.0), rotation[1] * rays[1].push(1.0)];
    let baseline = views[1].prior.pose.translation - views[0].prior.pose.translation;
    let normal = d[0].cross(&d[1]);
    let by_direction = [d[1].cross(&baseline), baseline.cross(&d[0])];
    let mut variance = 0.0;
    for (index, view) in views.iter().enumerate() {
        let covariance = &view.prior.covariance;
        let by_rotation = d[index].cross(&by_direction[index]);
        let rotation_covariance: Matrix3<f64> = covariance.fixed_view::<3, 3>(0, 0).into_owned();
        let position_covariance: Matrix3<f64> = covariance.fixed_view::<3, 3>(3, 3).into_owned();
        variance += quadratic(&rotation_covariance, &by_rotation) + quadratic(&position_covariance, &normal);
        variance += pixel_variance(camera, &rotation[index], &rays[index], &by_direction[index], sigma_px)?;
    }
    Some(baseline.dot(&normal).abs() / variance.sqrt())
}

fn quadratic(covariance: &Matrix3<f64>, direction: &Vector3<f64>) -> f64 {
    direction.dot(&(covariance * direction))
}

/// Variance of the epipolar error from one feature's pixel.
fn pixel_variance(
    camera: &Camera,
    rotation: &Matrix3<f64>,
    ray: &Vector2<f64>,
    by_direction: &Vector3<f64>,
    sigma_px: f64,
) -> Option<f64> {
    let (_, pixel_by_ray) = camera.distort_normalized_with_jacobian(ray);
    let by_ray = (rotation.transpose() * by_direction).xy();
    let by_pixel = pixel_by_ray.try_inverse()?.transpose() * by_ray;
    Some(by_pixel.norm_squared() * sigma_px * sigma_px)
}
