//! Stereo matching: which feature of the first camera's image is which of the second's, at the same instant.

use adjustment::{MIN_DEPTH, MountedCamera};
use geometry::camera::Camera;
use nalgebra::{Matrix3, Vector2, Vector3};
use vision::{DescriptorView, ImageFeatures, MatchOptions, distance};

use geometry::rotation::skew;

/// Largest distance of a feature from the epipolar line (px): localization of corners and errors of calibration.
const EPIPOLAR_GATE: f64 = 2.0;

/// The pixel in the second image of every feature of the first, `None` where no feature there has a similar descriptor
/// and satisfies the epipolar constraint.
///
/// The ratio test compares features near the epipolar line only, so it is not affected by textures that repeat elsewhere.
///
/// # Arguments
/// * `second_camera`: mounted on the first.
pub(super) fn match_stereo(
    camera: &Camera,
    second_camera: &MountedCamera,
    first: &ImageFeatures,
    second: &ImageFeatures,
) -> Vec<Option<Vector2<f64>>> {
    let [Some(left), Some(right)] =
        [StereoImage::new(camera, first), StereoImage::new(&second_camera.camera, second)]
    else {
        return vec![None; first.keypoints.len()];
    };
    let options = MatchOptions::for_metric(first.metric);
    let geometry = StereoGeometry::new(second_camera);
    let distances = |i: usize| -> Vec<(usize, f32)> {
        let Some(line) = left.rays[i].map(|ray| geometry.line(&ray)) else { return Vec::new() };
        let near = (0..right.rays.len())
            .filter(|&j| right.rays[j].is_some_and(|ray| line.contains(&ray, right.focal)));
        near.map(|j| (j, right.distance(j, &left, i))).collect()
    };
    let candidates: Vec<Vec<(usize, f32)>> = (0..left.rays.len()).map(distances).collect();
    let mut best_of_right = vec![(f32::INFINITY, usize::MAX); right.rays.len()];
    for (i, near) in candidates.iter().enumerate() {
        for &(j, distance) in near {
            if distance < best_of_right[j].0 {
                best_of_right[j] = (distance, i);
            }
        }
    }
    let partner = |(i, near): (usize, &Vec<(usize, f32)>)| {
        let (mut best, mut next) = ((usize::MAX, f32::INFINITY), f32::INFINITY);
        for &(j, distance) in near {
            if distance < best.1 {
                next = best.1;
                best = (j, distance);
            } else {
                next = next.min(distance);
            }
        }
        let distinct = options.ratio.is_none_or(|ratio| best.1 < ratio * next);
        let found = best.1 <= options.max_distance && distinct && best_of_right[best.0].1 == i;
        found.then(|| Vector2::from(second.keypoints[best.0].pixel.map(f64::from)))
    };
    candidates.iter().enumerate().map(partner).collect()
}

/// The features of one image with their bearings.
struct StereoImage<'a> {
    rays: Vec<Option<Vector3<f64>>>,
    descriptors: DescriptorView<'a>,
    /// Pixels per unit of normalized coordinates.
    focal: f64,
}

impl<'a> StereoImage<'a> {
    fn new(camera: &Camera, features: &'a ImageFeatures) -> Option<StereoImage<'a>> {
        let ray = |keypoint: &vision::Keypoint| {
            let pixel = Vector2::from(keypoint.pixel.map(f64::from));
            camera.unproject(&pixel).ok().map(|ray| ray.push(1.0))
        };
        Some(StereoImage {
            rays: features.keypoints.iter().map(ray).collect(),
            descriptors: DescriptorView::new(features.metric, features.width, &features.descriptors).ok()?,
            focal: f64::midpoint(camera.focal[0], camera.focal[1]),
        })
    }

    fn distance(&self, own: usize, other: &StereoImage<'_>, others: usize) -> f32 {
        match (self.descriptors.get(own), other.descriptors.get(others)) {
            (Some(a), Some(b)) => distance(self.descriptors.metric(), a, b),
            _ => f32::INFINITY,
        }
    }
}

/// The epipolar geometry of the two cameras.
struct StereoGeometry {
    rotation: Matrix3<f64>,
    offset: Vector3<f64>,
    essential: Matrix3<f64>,
}

/// The epipolar line of a ray, and the segment of it that points in front of both cameras project to.
struct EpipolarLine {
    line: Vector3<f64>,
    /// Normalized coordinates of the point at infinity and of the nearest possible one.
    ends: [Vector2<f64>; 2],
}

impl StereoGeometry {
    fn new(second: &MountedCamera) -> StereoGeometry {
        let (rotation, offset) = (second.rotation, second.offset);
        StereoGeometry { rotation, offset, essential: skew(&offset) * rotation }
    }

    fn line(&self, ray: &Vector3<f64>) -> EpipolarLine {
        let at = |inverse_depth: f64| {
            let p = self.rotation * ray + self.offset * inverse_depth;
            p.xy() / p.z.max(1e-6)
        };
        EpipolarLine { line: self.essential * ray, ends: [at(0.0), at(MIN_DEPTH.recip())] }
    }
}

impl EpipolarLine {
    /// Whether a ray of the second camera is near the segment.
    fn contains(&self, ray: &Vector3<f64>, focal: f64) -> bool {
        let gate = EPIPOLAR_GATE / focal;
        let away = self.line.dot(ray).abs() / self.line.xy().norm();
        let along = self.ends[1] - self.ends[0];
        let position = (ray.xy() - self.ends[0]).dot(&along) / along.norm();
        away <= gate && position >= -gate && position <= along.norm() + gate
    }
}
