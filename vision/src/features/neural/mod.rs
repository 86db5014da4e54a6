//! Features from networks (cargo feature `neural`).

mod dense;
pub mod graph;
mod network;
mod onnxruntime;
mod pickle;
pub mod quantize;
pub mod r2d2;
pub mod state_dict;
mod weights;
pub mod xfeat;
mod xfeat_network;

pub use network::{Engine, Network, NetworkError};
pub use r2d2::R2d2Extractor;
pub use weights::WeightsError;
pub use xfeat::XfeatExtractor;
pub use xfeat_network::write as write_xfeat;

use crate::{ExtractError, GrayImage, Keypoint};

/// An image must have at least `least` pixels a side, and its mask the same size.
fn check_size(image: &GrayImage, mask: Option<&GrayImage>, least: usize) -> Result<(), ExtractError> {
    let (width, height) = (image.width(), image.height());
    if width < least || height < least {
        return Err(ExtractError::TooSmall { width, height, least });
    }
    match mask.map(|mask| (mask.width(), mask.height())) {
        Some(mask) if mask != (width, height) => Err(ExtractError::MaskSize { mask, image: (width, height) }),
        _ => Ok(()),
    }
}

/// The `count` candidates of the highest score that lie in the image and where the mask is not zero, best first, and
/// what comes with them.
fn best<T>(
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
