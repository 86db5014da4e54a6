//! Laws of the features from networks. Nothing here needs downloaded weights but the tests of `published.rs`.

mod extractors;
mod files;
mod networks;
mod published;
mod reference;

use crate::weights_file;
use rand::{RngExt as _, SeedableRng as _, rngs::Xoshiro256PlusPlus};
use reference::Tensors;
use vision::features::StateDict;
use vision::features::neural::Engine;

/// The engines of this machine: rten always, ONNX Runtime where its library is.
fn engines() -> Vec<Engine> {
    let mut engines = vec![Engine::Rten];
    if Engine::best() == Engine::OnnxRuntime {
        engines.push(Engine::OnnxRuntime);
    } else {
        eprintln!("the library of ONNX Runtime is not here: only rten is tested");
    }
    engines
}

/// XFeat's tensors with random numbers that neither die out nor explode.
fn random_xfeat(seed: u64) -> Tensors {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    let tensor = |(name, shape): (String, Vec<usize>)| {
        let count: usize = shape.iter().product();
        let amplitude = (6.0 / shape[1..].iter().product::<usize>() as f32).sqrt();
        let (low, high) = if name.ends_with("var") { (0.5, 1.5) } else { (-amplitude, amplitude) };
        let (low, high) =
            if name.ends_with("mean") || name.ends_with("bias") { (-0.3, 0.3) } else { (low, high) };
        (name, (shape, (0..count).map(|_| random.random_range(low..high)).collect()))
    };
    reference::xfeat_shapes().into_iter().map(tensor).collect()
}

fn state(tensors: &Tensors) -> StateDict {
    StateDict::read(&weights_file::write(tensors)).unwrap()
}
