//! In which parts of an image matches confirm what the map expects there.

use geometry::{Camera, Pose};
use protocol::FeatureSet;

use super::expected::expected_pixels;
use super::grid::Grid;
use super::likelihood::log_likelihood_ratio;
use crate::loaded_map::LoadedMap;
use crate::verification::VerifiedKeyframe;

/// Landmarks that a part must hold for something to be expected in it: a descriptor is found again with a chance of a tenth to
/// a half. As many features must be left for it, if they are spread as the landmarks are.
const LEAST_EXPECTED: f64 = 5.0;
/// Area of a thing that a building has more than once, square metres: a door, a poster, the face of a shelf.
const PICTURE_AREA_M2: f64 = 2.0;
/// Matches that confirm a part.
const LEAST_CONFIRMING: usize = 2;

/// What a claimed pose explains of the parts of an image in which the map expects something.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct Coverage {
    /// Parts in which the map expects landmarks.
    pub expected: usize,
    /// Those of them in which matches agree with the pose.
    pub confirmed: usize,
    /// Parts of the image: the fewer features it has, the fewer.
    pub parts: usize,
    /// Parts that a picture of two square metres would fill where the inliers are: the nearer it is, the more.
    pub picture: f64,
}

impl Coverage {
    /// Natural logarithm of the likelihood of the right place over that of a picture that repeats.
    pub fn log_likelihood_ratio(&self) -> f64 {
        log_likelihood_ratio(self.confirmed, self.expected, self.parts, self.picture)
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
    let grid = Grid::of(camera, features.len());
    let features_of_a_landmark = (features.len() as f64 / expected.len().max(1) as f64).min(1.0);
    let expected = grid.count(expected.iter().map(|pixel| [pixel.x, pixel.y]));
    let confirming = grid.count(confirming.iter().map(|&query| features.pixels[query].map(f64::from)));
    let picture = grid.filled_by(PICTURE_AREA_M2, median_depth(map, global_from_camera, place));
    let mut coverage = Coverage { picture, parts: grid.len(), ..Coverage::default() };
    for (&expected, &confirming) in expected.iter().zip(&confirming) {
        let is_confirmed = confirming >= LEAST_CONFIRMING;
        let is_expected = expected as f64 * features_of_a_landmark >= LEAST_EXPECTED;
        coverage.expected += usize::from(is_confirmed || is_expected);
        coverage.confirmed += usize::from(is_confirmed);
    }
    coverage
}

/// Median depth of the inliers, metres; infinite without any.
fn median_depth(map: &LoadedMap, global_from_camera: &Pose, place: &[&VerifiedKeyframe]) -> f64 {
    let mut depths: Vec<f64> = Vec::new();
    for verified in place {
        let global_from_keyframe = &map.keyframes[verified.keyframe].global_from_keyframe.pose;
        let camera_from_keyframe = global_from_camera.inverse().compose(global_from_keyframe);
        depths.extend(verified.inlier_points().map(|point| camera_from_keyframe.transform(point).z));
    }
    depths.sort_unstable_by(f64::total_cmp);
    depths.get(depths.len() / 2).copied().unwrap_or(f64::INFINITY)
}
