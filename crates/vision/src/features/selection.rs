//! Selection of the best keypoints.

use crate::features::extractor::Keypoint;
use crate::image::GrayImage;
use std::cmp::Ordering;

/// The `count` candidates of highest score inside the image and the mask, best first, with their attachments.
pub(super) fn select_best<T>(
    mut candidates: Vec<(Keypoint, T)>,
    image: &GrayImage,
    mask: Option<&GrayImage>,
    count: usize,
) -> (Vec<Keypoint>, Vec<T>) {
    candidates.retain(|(keypoint, _)| {
        let [u, v] = keypoint.pixel.map(f32::round);
        let inside = u >= 0.0 && v >= 0.0 && (u as usize) < image.width() && (v as usize) < image.height();
        inside && mask.is_none_or(|mask| mask.get(u as usize, v as usize) != 0)
    });
    if candidates.len() > count {
        candidates.select_nth_unstable_by(count, |(a, _), (b, _)| order(a, b));
        candidates.truncate(count);
    }
    candidates.sort_by(|(a, _), (b, _)| order(a, b));
    candidates.into_iter().unzip()
}

/// Best score first; equal ones by rows.
fn order(a: &Keypoint, b: &Keypoint) -> Ordering {
    let [ua, va] = a.pixel;
    let [ub, vb] = b.pixel;
    b.score.total_cmp(&a.score).then(va.total_cmp(&vb)).then(ua.total_cmp(&ub))
}
