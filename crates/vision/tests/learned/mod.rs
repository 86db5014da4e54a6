//! Laws of the features from networks, of their layers, and of the files of their weights. Nothing here needs downloaded weights but
//! the tests of `published.rs`.

mod dots;
mod edgepoint;
mod files;
mod layers;
mod networks;
mod published;
mod published_networks;
mod state_dict;

use crate::reference::Tensors;
use crate::weights_file;
use rand::{RngExt as _, SeedableRng as _, rngs::Xoshiro256PlusPlus};
use vision::features::StateDict;

/// Tensors with random numbers that neither die out nor explode.
fn random_tensors(shapes: Vec<(String, Vec<usize>)>, seed: u64) -> Tensors {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    let tensor = |(name, shape): (String, Vec<usize>)| {
        let count: usize = shape.iter().product();
        let amplitude = (6.0 / shape[1..].iter().product::<usize>() as f32).sqrt();
        let (low, high) = if name.ends_with("var") { (0.5, 1.5) } else { (-amplitude, amplitude) };
        let (low, high) =
            if name.ends_with("mean") || name.ends_with("bias") { (-0.3, 0.3) } else { (low, high) };
        (name, (shape, (0..count).map(|_| random.random_range(low..high)).collect()))
    };
    shapes.into_iter().map(tensor).collect()
}

fn state(tensors: &Tensors) -> StateDict {
    StateDict::read(&weights_file::write(tensors)).unwrap()
}
