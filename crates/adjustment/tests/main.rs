//! Laws of the adjustment.
#![allow(clippy::unwrap_used)]

mod elimination;
mod gradients;
mod minimum;
mod scene;
