//! Where a camera should see the landmarks of a map from a pose.

use geometry::{Camera, Pose, Viewpoint};
use nalgebra::{Vector2, Vector3};
use std::ops::RangeInclusive;

use crate::loaded_map::LoadedMap;
use crate::verification::VerifiedKeyframe;

/// Keyframes near the pose whose landmarks are looked at, at most: those that see most like the camera.
const MAX_VIEWS: usize = 12;
/// Verified keyframes whose landmarks are looked at, at most.
const MAX_VERIFIED: usize = 4;
/// Cosine of the largest angle between the optical axes of the camera and of a keyframe near by.
const LEAST_AXIS_COSINE: f64 = 0.5;
/// Largest distance of such a keyframe, as a part of the map's viewing distance.
const VIEW_RADIUS: f64 = 1.0;
/// A keyframe that looks aside by this angle (rad) is as unlike as one at a third of the viewing distance.
const VIEW_ANGLE: f64 = 0.5;
/// Part of a keyframe's inliers on either side that may be seen from less similar directions and distances than the rest.
const ATYPICAL: f64 = 0.1;

/// From how different directions and distances a landmark is found again.
struct Similarity {
    /// Cosine of the largest angle between the rays.
    least_cosine: f64,
    /// Distance from the camera over that from the keyframe.
    distance_ratio: RangeInclusive<f64>,
}

/// Whatever is seen within 15 degrees and a third of the distance looks the same.
const SIMILAR: Similarity = Similarity { least_cosine: 0.966, distance_ratio: 0.75..=1.33 };

impl Similarity {
    /// The inliers of a keyframe were found again from where they are seen: what is seen alike should be found as well.
    fn of_inliers(keyframe: &VerifiedKeyframe, camera_from_keyframe: &Pose) -> Option<Self> {
        let mut cosines = Vec::with_capacity(keyframe.inliers.len());
        let mut ratios = Vec::with_capacity(keyframe.inliers.len());
        for point in keyframe.inlier_points() {
            let (cosine, ratio) = compare(point, camera_from_keyframe);
            cosines.push(cosine);
            ratios.push(ratio);
        }
        cosines.sort_unstable_by(f64::total_cmp);
        ratios.sort_unstable_by(f64::total_cmp);
        let atypical = (ATYPICAL * ratios.len() as f64) as usize;
        let (smallest, largest) = (ratios.get(atypical)?, ratios.get(ratios.len() - 1 - atypical)?);
        Some(Self {
            least_cosine: cosines.get(atypical)?.min(SIMILAR.least_cosine),
            distance_ratio: smallest.min(*SIMILAR.distance_ratio.start())
                ..=largest.max(*SIMILAR.distance_ratio.end()),
        })
    }

    fn holds(&self, (cosine, ratio): (f64, f64)) -> bool {
        cosine >= self.least_cosine && self.distance_ratio.contains(&ratio)
    }
}

/// Cosine of the angle between the rays from camera and keyframe to a point, and the ratio of their lengths.
fn compare(point_in_keyframe: &Vector3<f64>, camera_from_keyframe: &Pose) -> (f64, f64) {
    let from_camera = camera_from_keyframe.transform(point_in_keyframe);
    compare_rays(&from_camera, &(camera_from_keyframe.rotation * point_in_keyframe))
}

/// Cosine of the angle between the rays from a camera and from a keyframe to a point, and the ratio of their lengths.
fn compare_rays(from_camera: &Vector3<f64>, from_keyframe: &Vector3<f64>) -> (f64, f64) {
    let (length, length_before) = (from_camera.norm(), from_keyframe.norm());
    (from_camera.dot(from_keyframe) / (length * length_before), length / length_before)
}

/// A landmark that a camera should see.
pub(super) struct ExpectedLandmark {
    /// Where it should be in the image, pixels.
    pub pixel: Vector2<f64>,
    /// Where it is in G, metres.
    pub in_global: Vector3<f64>,
}

/// The landmarks that a camera should see, each once, in any order: those that a keyframe near by saw from a similar direction and distance, and
/// those that a verified keyframe saw as it saw its inliers.
///
/// What hides a landmark from the camera is not known, except that a keyframe near by saw it.
pub(super) fn expected_landmarks(
    map: &LoadedMap,
    camera: &Camera,
    global_from_camera: &Pose,
    place: &[&VerifiedKeyframe],
) -> Vec<ExpectedLandmark> {
    // One of many keyframes that saw a landmark is enough: where it is in the others is not computed.
    let mut is_expected = vec![false; map.landmark_count()];
    let mut expected = Vec::new();
    let mut add = |keyframe: usize, camera_from_keyframe: &Pose, similarity: &Similarity| {
        let observed = map.observations.of(keyframe);
        let keyframe_position = map.poses.viewpoints[keyframe].position;
        for at in 0..observed.landmarks.len() {
            let landmark = observed.landmark(at);
            if is_expected[landmark] {
                continue;
            }
            // The map's position is good enough to tell whether the views are similar, and takes less time than the ray of the pixel.
            let in_global = map.landmark_position(landmark);
            let from_camera = in_global - global_from_camera.translation;
            if !similarity.holds(compare_rays(&from_camera, &(in_global - keyframe_position))) {
                continue;
            }
            let in_camera = camera_from_keyframe.transform(&map.observed_point(keyframe, at));
            if let Ok(pixel) = camera.project(&in_camera)
                && camera.contains(&pixel)
            {
                let in_global = global_from_camera.transform(&in_camera);
                expected.push(ExpectedLandmark { pixel, in_global });
                is_expected[landmark] = true;
            }
        }
    };
    let camera_from_global = global_from_camera.inverse();
    let camera_from = |keyframe: usize| {
        camera_from_global.compose(&map.poses.keyframes[keyframe].global_from_keyframe.pose)
    };
    for keyframe in similar_views(map, global_from_camera) {
        add(keyframe, &camera_from(keyframe), &SIMILAR);
    }
    for verified in place.iter().take(MAX_VERIFIED) {
        let camera_from_keyframe = camera_from(verified.keyframe);
        if let Some(similarity) = Similarity::of_inliers(verified, &camera_from_keyframe) {
            add(verified.keyframe, &camera_from_keyframe, &similarity);
        }
    }
    expected
}

/// The keyframes that see most like a camera, the most similar first.
fn similar_views(map: &LoadedMap, global_from_camera: &Pose) -> Vec<usize> {
    let wanted = Viewpoint::of(global_from_camera);
    let scale = map.viewing_distance.max(f64::MIN_POSITIVE);
    let difference = |at: usize| {
        let view = &map.poses.viewpoints[at];
        let cosine = view.axis.dot(&wanted.axis);
        let distance = (view.position - wanted.position).norm() / scale;
        let is_similar = cosine >= LEAST_AXIS_COSINE && distance <= VIEW_RADIUS;
        is_similar.then(|| ((3.0 * distance).powi(2) + (cosine.min(1.0).acos() / VIEW_ANGLE).powi(2), at))
    };
    let mut views: Vec<(f64, usize)> = (0..map.poses.viewpoints.len()).filter_map(difference).collect();
    let order = |a: &(f64, usize), b: &(f64, usize)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
    if views.len() > MAX_VIEWS {
        views.select_nth_unstable_by(MAX_VIEWS, order);
        views.truncate(MAX_VIEWS);
    }
    views.sort_unstable_by(order);
    views.into_iter().map(|(_, at)| at).collect()
}
