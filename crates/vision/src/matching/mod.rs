//! Descriptors, distances between them, and nearest-neighbour matching and search.
//!
//! | module | what |
//! |---|---|
//! | [`descriptors`] | descriptors in memory, metrics and distances |
//! | [`brute_force`] | matching two sets: nearest neighbours with distance, ratio and mutual checks |
//! | [`inverted_file`] | approximate search among very many descriptors, by a visual vocabulary |
//! | [`exact`](fn@exact) | vectors that are read into memory of exactly their length |
//! | [`packed`] | vectors of numbers that are read piece by piece |
//! | [`prototypes`] | few descriptors that represent all observations of one landmark |

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx2_rows;
pub mod brute_force;
pub mod descriptors;
mod exact;
pub mod inverted_file;
mod kernels;
pub mod packed;
mod prepared;
pub mod prototypes;
mod vocabulary;

pub use brute_force::{Match, MatchOptions, Matcher, match_descriptors, match_grouped};
pub use descriptors::{DescriptorError, DescriptorView, Metric, distance, hamming};
pub use exact::exact;
pub use inverted_file::{Hit, InvertedFile};
pub use prototypes::prototype_descriptors;
