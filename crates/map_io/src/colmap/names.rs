//! Names of the images of keyframes, as a recording in the EuRoC layout has them.

use geometry::camera::Camera;
use map::model::Keyframe;
use protocol::KeyframeId;
use std::collections::BTreeMap;

/// Names `cam0/STAMP.png`: the folder of the camera in the recording, the time stamp, and the suffix. Each name is given once.
///
/// Cameras are told apart by their calibration, and by which keyframes have one time: of two that were taken at the same time
/// the left one is `cam0`. A keyframe whose time is not known (0) is named by its id.
///
/// # Example
/// ```
/// assert!(map_io::colmap::image_names(&[], ".png").is_empty());
/// ```
pub fn image_names(keyframes: &[Keyframe], suffix: &str) -> BTreeMap<KeyframeId, String> {
    let calibrations = calibrations(keyframes);
    let mut by_time: BTreeMap<i64, Vec<&Keyframe>> = BTreeMap::new();
    for keyframe in keyframes {
        by_time.entry(keyframe.stamp_ns).or_default().push(keyframe);
    }
    let mut names = BTreeMap::new();
    for (stamp_ns, mut taken) in by_time {
        if stamp_ns == 0 {
            names.extend(
                taken.iter().map(|keyframe| (keyframe.id, format!("keyframe_{:06}{suffix}", keyframe.id))),
            );
            continue;
        }
        let index = |keyframe: &Keyframe| calibrations.iter().position(|camera| **camera == keyframe.camera);
        taken.sort_by_key(|keyframe| (index(keyframe), keyframe.id));
        let are_alike = taken.windows(2).any(|pair| pair[0].camera == pair[1].camera);
        if are_alike && taken.len() == 2 && is_left_of(taken[1], taken[0]) {
            taken.reverse();
        }
        for (place, keyframe) in taken.iter().enumerate() {
            let camera = if are_alike { place } else { index(keyframe).unwrap_or(0) };
            names.insert(keyframe.id, format!("cam{camera}/{stamp_ns}{suffix}"));
        }
    }
    names
}

/// The different calibrations: in the order of the keyframes, or of two that are a stereo pair the left one first.
fn calibrations(keyframes: &[Keyframe]) -> Vec<&Camera> {
    let mut cameras: Vec<&Camera> = Vec::new();
    for keyframe in keyframes {
        if !cameras.contains(&&keyframe.camera) {
            cameras.push(&keyframe.camera);
        }
    }
    let [first, second] = cameras[..] else { return cameras };
    let of = |camera: &Camera| -> BTreeMap<i64, &Keyframe> {
        let its = keyframes.iter().filter(|keyframe| keyframe.camera == *camera);
        its.map(|keyframe| (keyframe.stamp_ns, keyframe)).collect()
    };
    let (of_first, of_second) = (of(first), of(second));
    let pairs = of_first.iter().filter_map(|(stamp_ns, one)| Some((*one, *of_second.get(stamp_ns)?)));
    let votes: i64 = pairs.map(|(one, other)| if is_left_of(other, one) { 1 } else { -1 }).sum();
    if votes > 0 { vec![second, first] } else { cameras }
}

/// Whether a keyframe's camera is on the left of another's.
fn is_left_of(one: &Keyframe, other: &Keyframe) -> bool {
    let in_other =
        other.global_from_keyframe.pose.inverse_transform(&one.global_from_keyframe.pose.translation);
    in_other.x < 0.0
}
