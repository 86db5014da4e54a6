//! In which parts of an image matches confirm what the map expects there.

use geometry::{Camera, Pose};
use protocol::FeatureSet;

use super::expected::expected_pixels;
use super::likelihood::{PICTURE_PARTS, log_likelihood_ratio};
use crate::loaded_map::LoadedMap;
use crate::verification::VerifiedKeyframe;

/// Parts of an image: columns and rows.
const PARTS: [usize; 2] = [8, 6];
/// Landmarks that a part must hold for something to be expected in it: a descriptor is found again with a chance of a tenth to
/// a half.
const LEAST_EXPECTED: usize = 5;
/// Area of a thing that a building has more than once, square metres: a door, a poster, the face of a shelf.
const PICTURE_AREA_M2: f64 = 2.0;
/// Matches that confirm a part.
const LEAST_CONFIRMING: usize = 2;

/// What a claimed pose explains of the parts of an image in which the map expects something.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Coverage {
    /// Parts in which the map expects landmarks.
    pub expected: usize,
    /// Those of them in which matches agree with the pose.
    pub confirmed: usize,
    /// Parts that a picture that repeats would fill in the mean: the nearer it is, the more.
    pub picture: usize,
}

impl Coverage {
    /// Natural logarithm of the likelihood of the right place over that of a picture that repeats.
    pub fn log_likelihood_ratio(&self) -> f64 {
        log_likelihood_ratio(self.confirmed, self.expected, self.picture as f64)
    }
}

/// The coverage of an image by the landmarks of verified keyframes.
///
/// # Arguments
/// * `global_from_camera`: the claimed pose.
/// * `place`: the keyframes that agree on it.
pub(crate) fn coverage(
    map: &LoadedMap,
    camera: &Camera,
    features: &FeatureSet,
    global_from_camera: &Pose,
    place: &[&VerifiedKeyframe],
) -> Coverage {
    let expected = expected_pixels(map, camera, global_from_camera, place);
    let mut confirming: Vec<usize> =
        place.iter().flat_map(|keyframe| &keyframe.inliers).map(|inlier| inlier.query).collect();
    confirming.sort_unstable();
    confirming.dedup();
    let size = [camera.width, camera.height].map(f64::from);
    let expected = count(size, expected.iter().map(|pixel| [pixel.x, pixel.y]));
    let confirming = count(size, confirming.iter().map(|&query| features.pixels[query].map(f64::from)));
    let picture = parts_of_a_picture(map, camera, global_from_camera, place);
    let mut coverage = Coverage { picture, ..Coverage::default() };
    for (expected, confirming) in expected.iter().zip(&confirming) {
        let is_confirmed = *confirming >= LEAST_CONFIRMING;
        coverage.expected += usize::from(is_confirmed || *expected >= LEAST_EXPECTED);
        coverage.confirmed += usize::from(is_confirmed);
    }
    coverage
}

/// How many parts of the image a picture fills that is as far away as the inliers are in the mean (median).
fn parts_of_a_picture(
    map: &LoadedMap,
    camera: &Camera,
    global_from_camera: &Pose,
    place: &[&VerifiedKeyframe],
) -> usize {
    let mut depths: Vec<f64> = Vec::new();
    for verified in place {
        let global_from_keyframe = &map.keyframes[verified.keyframe].global_from_keyframe.pose;
        let camera_from_keyframe = global_from_camera.inverse().compose(global_from_keyframe);
        depths.extend(verified.inlier_points().map(|point| camera_from_keyframe.transform(point).z));
    }
    depths.sort_unstable_by(f64::total_cmp);
    let depth = depths.get(depths.len() / 2).copied().unwrap_or(f64::INFINITY);
    let side = |pixels: u32, parts: usize, focal: f64| f64::from(pixels) / parts as f64 / focal * depth;
    let part = side(camera.width, PARTS[0], camera.focal[0]) * side(camera.height, PARTS[1], camera.focal[1]);
    (PICTURE_AREA_M2 / part).clamp(PICTURE_PARTS, (PARTS[0] * PARTS[1]) as f64).round() as usize
}

/// How many pixels each part of an image holds.
fn count(size: [f64; 2], pixels: impl Iterator<Item = [f64; 2]>) -> Vec<usize> {
    let mut counts = vec![0; PARTS[0] * PARTS[1]];
    for pixel in pixels {
        let at = |axis: usize| {
            ((pixel[axis] / size[axis] * PARTS[axis] as f64).max(0.0) as usize).min(PARTS[axis] - 1)
        };
        counts[at(1) * PARTS[0] + at(0)] += 1;
    }
    counts
}
