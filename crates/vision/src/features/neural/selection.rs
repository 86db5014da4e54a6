//! Selection of the best keypoints.

use crate::features::extractor::Keypoint;
use crate::image::GrayImage;

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
    candidates.sort_by(|(a, _), (b, _)| b.score.total_cmp(&a.score));
    candidates.truncate(count);
    candidates.into_iter().unzip()
}
