//! Pairs of keyframes to match, and the matches of each pair.

use geometry::pose::Pose;
use geometry::uncertain_pose::PoseWithCovariance;
use nalgebra::{Matrix3, Matrix6, Vector2, Vector3, Vector6};
use std::collections::{BTreeMap, BTreeSet};
use vision::MatchOptions;

use super::camera::Rig;
use super::correlations::Correlations;
use super::error::BuildError;
use super::keyframe_view::KeyframeView;
use super::options::BuildOptions;
use geometry::camera::Camera;

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

/// A view, and which of its images.
pub(super) type ImageId = (usize, usize);

/// An image with the pose of its camera.
struct PosedImage {
    id: ImageId,
    group: usize,
    /// Its number among the images of its group that have features, in the order of time.
    number: usize,
    pose: Pose,
}

impl PosedImage {
    /// Direction of the optical axis in G.
    fn axis(&self) -> Vector3<f64> {
        self.pose.rotation * Vector3::z()
    }
}

/// All images of some views.
fn images(rig: &Rig, views: &[KeyframeView<'_>]) -> Vec<PosedImage> {
    let mut counts: BTreeMap<usize, usize> = BTreeMap::new();
    let mut images = Vec::new();
    for (view, content) in views.iter().enumerate() {
        for (image, of) in content.images.iter().enumerate() {
            let count = counts.entry(of.group).or_default();
            let pose = rig.camera_pose(of.group, &content.prior.pose);
            images.push(PosedImage { id: (view, image), group: of.group, number: *count, pose });
            *count += 1;
        }
    }
    images
}

/// Pairs of images of the same camera that are near in time, each with the earlier one first, in order.
pub(super) fn pairs_in_time(
    rig: &Rig,
    views: &[KeyframeView<'_>],
    options: &BuildOptions,
) -> Vec<(ImageId, ImageId)> {
    neighbours_in_time(&images(rig, views), options.time_neighbours)
}

/// # Arguments
/// * `count`: later images of the same camera that are neighbours of one.
fn neighbours_in_time(images: &[PosedImage], count: usize) -> Vec<(ImageId, ImageId)> {
    let of_image = |at: usize| {
        let own = &images[at];
        let near_in_time = images[at + 1..].iter().filter(|other| other.group == own.group).take(count);
        let same_direction = |other: &&PosedImage| own.axis().angle(&other.axis()) <= MAX_ANGLE_IN_TIME;
        near_in_time.filter(same_direction).map(|other| (own.id, other.id)).collect::<Vec<_>>()
    };
    (0..images.len()).flat_map(of_image).collect()
}

/// The pairs of images to match, in time and in space, each with the earlier one first. Images of one instant are not matched.
pub(super) fn pairs(
    rig: &Rig,
    views: &[KeyframeView<'_>],
    options: &BuildOptions,
) -> Vec<(ImageId, ImageId)> {
    let images = images(rig, views);
    let mut pairs: BTreeSet<(ImageId, ImageId)> =
        neighbours_in_time(&images, options.time_neighbours).into_iter().collect();
    for own in &images {
        let mut near_in_space: Vec<(f64, ImageId)> = images
            .iter()
            .filter(|other| !is_near_in_time(own, other, options.time_neighbours))
            .filter_map(|other| Some((spatial_distance(own, other)?, other.id)))
            .collect();
        near_in_space.sort_by(|a, b| a.0.total_cmp(&b.0));
        let nearest = near_in_space.iter().take(options.space_neighbours);
        pairs.extend(nearest.map(|&(_, other)| (own.id.min(other), own.id.max(other))));
    }
    pairs.into_iter().collect()
}

/// Whether two images are of one instant, or of one camera with fewer than so many images between them.
fn is_near_in_time(own: &PosedImage, other: &PosedImage, count: usize) -> bool {
    own.id.0 == other.id.0 || own.group == other.group && own.number.abs_diff(other.number) <= count
}

/// Distance measure of two images from position and direction, `None` for images that hardly overlap.
fn spatial_distance(a: &PosedImage, b: &PosedImage) -> Option<f64> {
    let distance = (a.pose.translation - b.pose.translation).norm();
    let angle = if distance <= MAX_DISTANCE_IN_SPACE { a.axis().angle(&b.axis()) } else { f64::INFINITY };
    (angle <= MAX_ANGLE_IN_SPACE).then_some(distance / MAX_DISTANCE_IN_SPACE + angle / MAX_ANGLE_IN_SPACE)
}

/// Matches two images: nearest descriptors in both directions with a ratio test, then the epipolar constraint.
///
/// # Arguments
/// * `correlations`: of the poses of the views; of views whose images are of mounted cameras they must be independent.
pub(super) fn match_pair(
    rig: &Rig,
    views: &[KeyframeView<'_>],
    (first, second): (ImageId, ImageId),
    correlations: &Correlations<'_>,
    sigma_px: f64,
    options: &BuildOptions,
) -> Result<Vec<FeatureMatch>, BuildError> {
    let [a, b] = [first, second].map(|(view, image)| &views[view].images[image]);
    let (of_first, of_second) = (a.descriptors()?, b.descriptors()?);
    let mut settings = MatchOptions::for_metric(of_first.metric());
    settings.max_distance = options.max_descriptor_distance.unwrap_or(settings.max_distance);
    let matches = vision::match_descriptors(of_first, of_second, &settings)?;
    let posed = |(view, image): ImageId, group: usize| MatchedImage {
        camera: rig.camera(group),
        pose: rig.uncertain_pose(group, &views[view].prior),
        rays: &views[view].rays[views[view].first_feature(image)..],
    };
    let images = [posed(first, a.group), posed(second, b.group)];
    let cross = correlations.between(first.0, second.0);
    let possible = |found: &vision::Match| {
        epipolar_error(&images, cross.as_ref(), [found.query, found.train], sigma_px)
            .is_some_and(|sigmas| sigmas <= EPIPOLAR_GATE)
    };
    let offsets = [first, second].map(|(view, image)| views[view].first_feature(image));
    Ok(matches
        .iter()
        .filter(|found| possible(found))
        .map(|found| FeatureMatch {
            first: (first.0, offsets[0] + found.query),
            second: (second.0, offsets[1] + found.train),
            distance: found.distance,
        })
        .collect())
}

/// One of two images that are matched.
struct MatchedImage<'a> {
    camera: &'a Camera,
    /// `global_from_camera`.
    pose: PoseWithCovariance,
    /// Of its features.
    rays: &'a [Option<Vector2<f64>>],
}

/// Epipolar error of two rays, in standard deviations from the noise of pixels and poses. `None` without rays.
///
/// ```text
/// e = c . (d1 x d2),   c = p2 - p1,   d = R [alpha, beta, 1]        (the volume that the three vectors span)
/// de/dp2 = d1 x d2 = -de/dp1,   de/dtheta1 = d1 x (d2 x c),   de/dtheta2 = d2 x (c x d1)
/// ```
///
/// # Arguments
/// * `cross`: covariance of the errors of the first pose with those of the second; `None` where they are independent.
fn epipolar_error(
    images: &[MatchedImage<'_>; 2],
    cross: Option<&Matrix6<f64>>,
    features: [usize; 2],
    sigma_px: f64,
) -> Option<f64> {
    let poses = [&images[0].pose, &images[1].pose];
    let rotation = poses.map(|pose| pose.pose.rotation.to_rotation_matrix().into_inner());
    let rays = [images[0].rays[features[0]]?, images[1].rays[features[1]]?];
    let d = [rotation[0] * rays[0].push(1.0), rotation[1] * rays[1].push(1.0)];
    let baseline = poses[1].pose.translation - poses[0].pose.translation;
    let normal = d[0].cross(&d[1]);
    let by_direction = [d[1].cross(&baseline), baseline.cross(&d[0])];
    let by_pose = [(0, -normal), (1, normal)].map(|(index, by_position): (usize, Vector3<f64>)| {
        let by_rotation = d[index].cross(&by_direction[index]);
        let mut gradient = Vector6::zeros();
        gradient.fixed_rows_mut::<3>(0).copy_from(&by_rotation);
        gradient.fixed_rows_mut::<3>(3).copy_from(&by_position);
        gradient
    });
    let mut variance = 0.0;
    for (index, image) in images.iter().enumerate() {
        variance += by_pose[index].dot(&(image.pose.covariance * by_pose[index]));
        variance +=
            pixel_variance(image.camera, &rotation[index], &rays[index], &by_direction[index], sigma_px)?;
    }
    if let Some(cross) = cross {
        variance += 2.0 * by_pose[0].dot(&(cross * by_pose[1]));
    }
    Some(baseline.dot(&normal).abs() / variance.sqrt())
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::correlations::tests::Neighbours;
    use rand::SeedableRng;
    use rand::rngs::StdRng;

    /// A rig whose two cameras take turns, with three views that only bridge a gap between two images.
    #[test]
    fn neighbours_in_time_are_images_of_the_same_camera() {
        let image =
            |at: usize| PosedImage { id: (4 * at, 0), group: at % 2, number: at / 2, pose: Pose::identity() };
        let images: Vec<PosedImage> = (0..20).map(image).collect();
        let pairs = neighbours_in_time(&images, 3);
        let of_first: Vec<usize> =
            pairs.iter().filter(|(own, _)| own.0 == 0).map(|(_, other)| other.0 / 4).collect();
        assert_eq!(of_first, [2, 4, 6]);
        // All but the last three of each camera have three.
        assert_eq!(pairs.len(), 2 * (7 * 3 + 2 + 1));
        for (own, other) in &pairs {
            let [own, other] = [own, other].map(|id| &images[id.0 / 4]);
            assert!(is_near_in_time(own, other, 3) && own.group == other.group);
        }
        assert!(!is_near_in_time(&images[0], &images[8], 3) && !is_near_in_time(&images[0], &images[1], 3));
        assert!(is_near_in_time(&images[0], &PosedImage { group: 1, ..image(0) }, 3));
    }

    /// Mean squared epipolar error of a point that both images see, in standard deviations, over poses that err as a map states.
    fn mean_square(is_correlated: bool) -> f64 {
        const SAMPLES: usize = 4000;
        let mut rng = StdRng::seed_from_u64(3);
        let neighbours = Neighbours::new(&mut rng);
        let point = Vector3::new(0.7, -0.4, 5.0);
        let rays = neighbours.truth.map(|pose| {
            let in_camera = pose.inverse_transform(&point);
            vec![Some(in_camera.xy() / in_camera.z)]
        });
        let camera = testing::camera();
        let correlations = neighbours.correlations();
        let cross = correlations.between(0, 1).filter(|_| is_correlated);
        let square = |poses: [PoseWithCovariance; 2]| {
            let images = [0, 1].map(|at| MatchedImage { camera: &camera, pose: poses[at], rays: &rays[at] });
            epipolar_error(&images, cross.as_ref(), [0, 0], 1e-6).unwrap().powi(2)
        };
        (0..SAMPLES).map(|_| square(neighbours.sample(&mut rng))).sum::<f64>() / SAMPLES as f64
    }

    #[test]
    fn the_epipolar_error_is_as_large_as_correlated_poses_make_it() {
        // Of 4,000 samples the mean has a standard deviation of 0.022.
        let mean = mean_square(true);
        assert!((0.9..1.1).contains(&mean), "{mean}");
        // Taken for independent, the poses of neighbours would admit matches that are far from the epipolar line.
        let mean = mean_square(false);
        assert!(mean < 0.1, "{mean}");
    }
}
