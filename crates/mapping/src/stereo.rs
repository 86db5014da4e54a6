//! Which feature of the left image is which of the right one, at the same instant.

use nalgebra::{Matrix3, Vector2, Vector3};
use vision::{DescriptorView, ImageFeatures, MatchOptions, distance};

use geometry::rotation::skew;

use super::point::{Lens, MIN_DEPTH};

/// Farthest that a feature may be from its partner's epipolar line (px): what corners scatter, and calibrations err.
const EPIPOLAR_GATE: f64 = 2.0;

/// The pixel in the second image of every feature of the first, `None` where no feature there looks alike and can be
/// the same point.
///
/// Only features near the epipolar line compete, so the ratio test is fair to textures that repeat elsewhere.
pub(super) fn match_stereo(
    rig: &[Lens],
    first: &ImageFeatures,
    second: &ImageFeatures,
) -> Vec<Option<Vector2<f64>>> {
    let [Some(left), Some(right)] = [Side::new(&rig[0], first), Side::new(&rig[1], second)] else {
        return vec![None; first.keypoints.len()];
    };
    let options = MatchOptions::for_metric(first.metric);
    let geometry = Geometry::new(&rig[1]);
    let distances = |i: usize| -> Vec<(usize, f32)> {
        let Some(line) = left.rays[i].map(|ray| geometry.line(&ray)) else { return Vec::new() };
        let near =
            (0..right.rays.len()).filter(|&j| right.rays[j].is_some_and(|ray| line.holds(&ray, right.focal)));
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

/// The features of one image, ready to be compared.
struct Side<'a> {
    rays: Vec<Option<Vector3<f64>>>,
    descriptors: DescriptorView<'a>,
    /// Pixels a unit of normalized coordinates.
    focal: f64,
}

impl<'a> Side<'a> {
    fn new(lens: &Lens, features: &'a ImageFeatures) -> Option<Side<'a>> {
        let ray = |keypoint: &vision::Keypoint| {
            let pixel = Vector2::from(keypoint.pixel.map(f64::from));
            lens.camera.unproject(&pixel).ok().map(|ray| ray.push(1.0))
        };
        Some(Side {
            rays: features.keypoints.iter().map(ray).collect(),
            descriptors: DescriptorView::new(features.metric, features.width, &features.descriptors).ok()?,
            focal: f64::midpoint(lens.camera.focal[0], lens.camera.focal[1]),
        })
    }

    fn distance(&self, own: usize, other: &Side<'_>, others: usize) -> f32 {
        match (self.descriptors.get(own), other.descriptors.get(others)) {
            (Some(a), Some(b)) => distance(self.descriptors.metric(), a, b),
            _ => f32::INFINITY,
        }
    }
}

/// Where a point of the first camera can appear in the second.
struct Geometry {
    rotation: Matrix3<f64>,
    offset: Vector3<f64>,
    essential: Matrix3<f64>,
}

/// The epipolar line of a ray, and which part of it shows points in front of both cameras.
struct EpipolarLine {
    line: Vector3<f64>,
    /// Normalized coordinates of the point at infinity and of the nearest possible one.
    ends: [Vector2<f64>; 2],
}

impl Geometry {
    fn new(second: &Lens) -> Geometry {
        let (rotation, offset) = second.lens_from_first();
        Geometry { rotation, offset, essential: skew(&offset) * rotation }
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
    /// Whether a ray of the second camera is near the line, between its ends.
    fn holds(&self, ray: &Vector3<f64>, focal: f64) -> bool {
        let gate = EPIPOLAR_GATE / focal;
        let away = self.line.dot(ray).abs() / self.line.xy().norm();
        let along = self.ends[1] - self.ends[0];
        let position = (ray.xy() - self.ends[0]).dot(&along) / along.norm();
        away <= gate && position >= -gate && position <= along.norm() + gate
    }
}
