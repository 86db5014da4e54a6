//! Features from networks (cargo feature `neural`): [`XfeatExtractor`] (`xfeat-1`) and [`R2d2Extractor`] (`r2d2-1`).
//!
//! | module | what |
//! |---|---|
//! | [`xfeat`], [`r2d2`] | the extractors |
//! | [`state_dict`] | tensors out of files that torch wrote, without torch |
//! | [`graph`] | writes a network as an ONNX file in memory |
//! | [`quantize`] | descriptors as signed bytes |
//!
//! # Engines
//! XFeat at 736 x 480 in one thread, AVX-512, all in turn on a machine with other work (22 runs each, in turn; the
//! least time is the nearest to that of an idle machine, the median is a fair comparison):
//!
//! | engine | least, median, ms | build, CPU s | crates | size |
//! |---|---|---|---|---|
//! | onnxruntime 1.31 from Python | 18.6, 50 | | | |
//! | **`ort` 2.0.0-rc.15, its library loaded at run time** | 19.6, 52 | 14 | 12 | library 29 MB |
//! | **`rten` 0.27**, pure Rust | 45, 134 | 81 | 24 | program 6 MB |
//! | `tract-onnx` 0.23.9, pure Rust | 63, 116 | | 97 | program 30 MB |
//!
//! No engine in pure Rust stays within 1.5 times onnxruntime's time, so [`Engine::best`] takes ONNX Runtime where its
//! library is, and rten elsewhere.
//!
//! # What XFeat's matches are worth
//! `images/v1_01_keyframes` of `target/data`: the left images of even number (1000 features) against the landmarks
//! of the odd ones (1500 features, 656 triangulated from the stereo pair). Right: within 5 px of the landmark's
//! reprojection by the true poses; of the 194 pairs within 1 m and 35 degrees. Elsewhere: pairs more than 2 m or 100
//! degrees apart, all wrong. Mutual matches a pair:
//!
//! | max_distance | ratio | right, signed bytes (`f32`) | wrong | elsewhere |
//! |---|---|---|---|---|
//! | 0.1 | none | 148.9 (148.9) | 66.7 | 4.1 |
//! | 0.2 | none | 184.3 (184.4) | 134.1 | 65.8 |
//! | 0.3 | none | 186.3 (186.4) | 152.7 | 168.8 |
//! | 0.3 | 0.9 | 174.3 (174.3) | 117.6 | 76.0 |
//! | 0.3 | 0.8 | 157.4 (157.3) | 87.8 | 28.7 |
//! | **0.2** | **0.8** | **157.0 (156.9)** | **85.9** | **22.2** |
//! | 0.15 | 0.8 | 153.3 (153.3) | 77.5 | 11.1 |
//! | 0.3 | 0.64 | 120.4 (120.5) | 50.8 | 5.7 |
//!
//! So bytes cost nothing that can be measured. Distances of right matches: median 0.057, 90 % below 0.13, 99 % below
//! 0.20. The ratio decides, not the distance.
//!
//! Images of even number localized against that map (four keyframes of most matches, RANSAC at 3 px): of 49 within
//! 5 cm and 1 degree, and, with the image made worse, within 10 cm and 2 degrees. Two images more or less are chance:
//!
//! | map, query, max_distance (ratio 0.8) | as it is | gamma 2.5 | blur of 2 px | 0.4 of the brightness, noise of 8 |
//! |---|---|---|---|---|
//! | 2000, 1000, 0.2 | 47 | 48 | 49 | 47 |
//! | 2000, 1000, 0.3 | 47 | 48 | 49 | 45 |
//! | 1500, 1000, 0.2 | 46 | 47 | 49 | 46 |
//! | 1500, 1000, 0.3 | 48 | 47 | 49 | 44 |
//! | 1000, 500, 0.3 | 42 | 47 | 47 | 42 |
//!
//! Where keypoints lie (1500, 1000, 0.3): parabola 48, centre of mass of 3 x 3 pixels 47, of 5 x 5 pixels 45, whole
//! pixels 45. The median error is 1 cm and 0.2 degrees.

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

use crate::{GrayImage, Keypoint};

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
