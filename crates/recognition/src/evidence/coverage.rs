//! In which parts of an image matches confirm what the map expects there.

use geometry::pnp::Correspondence;
use geometry::{Camera, Pose, median};
use nalgebra::{Vector2, Vector3};
use protocol::FeatureSet;

use super::expected::expected_landmarks;
use super::grid::Grid;
use super::likelihood::log_likelihood_ratio;
use super::picture::Picture;
use crate::extractor_statistics::ExtractorStatistics;
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
    /// Of the parts that show the picture in which most inliers are.
    pub within_picture: PartCounts,
    /// Of the other ones.
    pub beyond_picture: PartCounts,
    /// Parts of the image: the fewer features it has, the fewer.
    pub parts: usize,
    /// Parts that a picture of two square metres would fill where the inliers are: the nearer it is, the more.
    pub picture: f64,
    /// Chance that a picture that repeats confirms another part beyond it, by the extractor of the map.
    pub chance_beyond: f64,
}

/// Parts of an image.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PartCounts {
    /// Those in which the map expects landmarks.
    pub expected: usize,
    /// Those of them in which matches agree with the pose.
    pub confirmed: usize,
}

impl Coverage {
    /// Of all parts.
    pub fn of_image(&self) -> PartCounts {
        let (within, beyond) = (self.within_picture, self.beyond_picture);
        PartCounts {
            expected: within.expected + beyond.expected,
            confirmed: within.confirmed + beyond.confirmed,
        }
    }

    /// Natural logarithm of the likelihood of the right place over that of a picture that repeats.
    pub fn log_likelihood_ratio(&self) -> f64 {
        log_likelihood_ratio(self)
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
    let expected = expected_landmarks(map, camera, global_from_camera, place);
    let statistics = ExtractorStatistics::of(&map.info.extractor);
    let is_confirming = |error_px: f64| error_px <= statistics.confirming_angle * mean_focal(camera);
    let inliers = distinct_inliers(map, camera, features, global_from_camera, place, is_confirming);
    let points: Vec<Vector3<f64>> = inliers.iter().map(|(_, in_global)| *in_global).collect();
    let Some(picture) = Picture::of_most(&points, &global_from_camera.translation) else {
        return Coverage::default();
    };
    let grid = Grid::of(camera, features.len());
    let features_of_a_landmark = (features.len() as f64 / expected.len().max(1) as f64).min(1.0);
    let expected_where = |within: bool| {
        let there = expected.iter().filter(|landmark| picture.contains(&landmark.in_global) == within);
        grid.count(there.map(|landmark| [landmark.pixel.x, landmark.pixel.y]))
    };
    let confirming_where = |within: bool| {
        let there = inliers.iter().filter(|(_, in_global)| picture.contains(in_global) == within);
        grid.count(there.map(|&(query, _)| features.pixels[query].map(f64::from)))
    };
    let (expected, confirming) = ([true, false].map(expected_where), [true, false].map(confirming_where));
    let depth = median_depth(&points, global_from_camera);
    let mut coverage = Coverage {
        chance_beyond: statistics.chance_beyond,
        picture: grid.filled_by(PICTURE_AREA_M2, depth),
        parts: grid.len(),
        ..Coverage::default()
    };
    for part in 0..grid.len() {
        let [within, beyond] = [0, 1].map(|side| (expected[side][part], confirming[side][part]));
        let is_confirmed = within.1 + beyond.1 >= LEAST_CONFIRMING;
        let is_expected = (within.0 + beyond.0) as f64 * features_of_a_landmark >= LEAST_EXPECTED;
        let is_beyond = if is_confirmed {
            beyond.1 >= LEAST_CONFIRMING && beyond.1 > within.1
        } else {
            beyond.0 > within.0
        };
        let counts = if is_beyond { &mut coverage.beyond_picture } else { &mut coverage.within_picture };
        counts.expected += usize::from(is_confirmed || is_expected);
        counts.confirmed += usize::from(is_confirmed);
    }
    coverage
}

/// The features that inliers match, each once, and their landmarks in G (metres).
///
/// # Arguments
/// * `is_confirming`: which inliers count, by their reprojection error with the claimed pose (px).
fn distinct_inliers(
    map: &LoadedMap,
    camera: &Camera,
    features: &FeatureSet,
    global_from_camera: &Pose,
    place: &[&VerifiedKeyframe],
    is_confirming: impl Fn(f64) -> bool,
) -> Vec<(usize, Vector3<f64>)> {
    let mut inliers = Vec::new();
    for verified in place {
        let global_from_keyframe = &map.poses.keyframes[verified.keyframe].global_from_keyframe.pose;
        for (inlier, point) in verified.inliers.iter().zip(verified.inlier_points()) {
            let in_global = global_from_keyframe.transform(point);
            let pixel = Vector2::from(features.pixels[inlier.query].map(f64::from));
            let landmark = Correspondence { point: in_global, pixel };
            if landmark.reprojection_error(camera, global_from_camera).is_some_and(&is_confirming) {
                inliers.push((inlier.query, in_global));
            }
        }
    }
    // A stable sort: of a feature that several keyframes match, the first one's landmark.
    inliers.sort_by_key(|(query, _)| *query);
    inliers.dedup_by_key(|(query, _)| *query);
    inliers
}

/// Pixels of an angle of one radian.
fn mean_focal(camera: &Camera) -> f64 {
    f64::midpoint(camera.focal[0], camera.focal[1])
}

/// Median depth of points in G (metres), metres.
fn median_depth(points: &[Vector3<f64>], global_from_camera: &Pose) -> f64 {
    let depth = |point: &Vector3<f64>| global_from_camera.inverse_transform(point).z;
    let mut depths: Vec<f64> = points.iter().map(depth).collect();
    median(&mut depths).unwrap_or(f64::INFINITY)
}
