//! Features from networks (cargo feature `neural`): [`XfeatExtractor`] (`xfeat-1`) and [`R2d2Extractor`] (`r2d2-1`).
//!
//! | module | what |
//! |---|---|
//! | [`xfeat`], [`r2d2`] | the extractors |
//! | [`network`] | inference engines |
//! | [`graph`] | writes a network as an ONNX file in memory |
//!
//! # Engines
//! XFeat at 736 x 480 in one thread, AVX-512, on a machine with other load (22 interleaved runs each; the minimum is
//! closest to an idle machine, the median is a fair comparison):
//!
//! | engine | minimum, median, ms | build, CPU s | crates | size |
//! |---|---|---|---|---|
//! | onnxruntime 1.31 from Python | 18.6, 50 | | | |
//! | **`ort` 2.0.0-rc.15, library loaded at run time** | 19.6, 52 | 14 | 12 | library 29 MB |
//! | **`rten` 0.27**, pure Rust | 45, 134 | 81 | 24 | program 6 MB |
//! | `tract-onnx` 0.23.9, pure Rust | 63, 116 | | 97 | program 30 MB |
//!
//! No engine in pure Rust is within 1.5 times the time of ONNX Runtime, so [`Engine::best`] chooses ONNX Runtime if its
//! library is found, rten otherwise.
//!
//! # Match quality of XFeat
//! `images/v1_01_keyframes` of `target/data`: the left images of even number (1000 features) against the landmarks
//! of the odd ones (1500 features, 656 triangulated from the stereo pair). Correct: within 5 px of the reprojection of
//! the landmark by the true poses, for the 194 pairs within 1 m and 35 degrees. Elsewhere: pairs more than 2 m or 100
//! degrees apart, all wrong. Mutual matches per pair:
//!
//! | max_distance | ratio | correct, signed bytes (`f32`) | wrong | elsewhere |
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
//! Quantization has no measurable cost. Distances of correct matches: median 0.057, 90 % below 0.13, 99 % below
//! 0.20. The ratio test matters more than the distance.
//!
//! Images of even number localized against that map (the four keyframes with most matches, RANSAC at 3 px): number of 49
//! within 5 cm and 1 degree, and, with degraded images, within 10 cm and 2 degrees. Differences of two are not
//! significant:
//!
//! | map, query, max_distance (ratio 0.8) | original | gamma 2.5 | blur of 2 px | 0.4 of the brightness, noise of 8 |
//! |---|---|---|---|---|
//! | 2000, 1000, 0.2 | 47 | 48 | 49 | 47 |
//! | 2000, 1000, 0.3 | 47 | 48 | 49 | 45 |
//! | 1500, 1000, 0.2 | 46 | 47 | 49 | 46 |
//! | 1500, 1000, 0.3 | 48 | 47 | 49 | 44 |
//! | 1000, 500, 0.3 | 42 | 47 | 47 | 42 |
//!
//! Keypoint refinement (1500, 1000, 0.3): parabola 48, centre of mass of 3 x 3 pixels 47, of 5 x 5 pixels 45, whole
//! pixels 45. The median error is 1 cm and 0.2 degrees.

mod dense_maps;
pub mod graph;
pub mod network;
pub mod r2d2;
mod weights;
pub mod xfeat;
mod xfeat_network;

pub use network::{Engine, Network, NetworkError};
pub use r2d2::R2d2Extractor;
pub use weights::{WeightsError, sha256};
pub use xfeat::XfeatExtractor;
pub use xfeat_network::write as write_xfeat;
