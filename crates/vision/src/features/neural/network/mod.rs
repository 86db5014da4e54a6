//! Runs an ONNX network on the CPU in one thread: a robot processes one image at a time, and the other cores are busy.
//!
//! Two engines give the same numbers (to a relative 1e-4): [`Engine::Rten`] is pure Rust and always available;
//! [`Engine::OnnxRuntime`] is faster and needs a shared library. [`Engine::best`] chooses the faster one available.

mod error;
mod onnxruntime;
mod rten;

pub use error::{EngineError, NetworkError};

use crate::features::tensor::Tensor;

/// An inference engine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Engine {
    /// ONNX Runtime, from its shared library.
    OnnxRuntime,
    /// The crate `rten`.
    Rten,
}

impl Engine {
    /// ONNX Runtime if its library is found, else rten.
    ///
    /// The library is searched once per process, in this order: the file that `$ORT_DYLIB_PATH` names, `libonnxruntime.so` in
    /// the default folder of weights (where `driftless weights onnxruntime` puts it), and `libonnxruntime.so` on the
    /// library path of the system.
    pub fn best() -> Self {
        if onnxruntime::environment().is_some() { Self::OnnxRuntime } else { Self::Rten }
    }
}

/// A network with one input image and several output maps.
pub struct Network {
    outputs: Vec<String>,
    loaded: Loaded,
}

enum Loaded {
    OnnxRuntime(onnxruntime::Session),
    Rten(Box<rten::Session>),
}

impl Network {
    /// Loads the bytes of an ONNX file.
    ///
    /// # Arguments
    /// * `input`, `outputs`: names of the input and output tensors.
    ///
    /// # Errors
    /// [`NetworkError::Load`], [`NetworkError::Tensor`], [`NetworkError::NoEngine`].
    pub fn load(onnx: Vec<u8>, input: &str, outputs: &[&str], engine: Engine) -> Result<Self, NetworkError> {
        let loaded = match engine {
            Engine::OnnxRuntime => Loaded::OnnxRuntime(onnxruntime::Session::load(&onnx, input, outputs)?),
            Engine::Rten => Loaded::Rten(Box::new(rten::Session::load(onnx, input, outputs)?)),
        };
        Ok(Self { outputs: outputs.iter().map(|&name| name.to_owned()).collect(), loaded })
    }

    /// Runs the network.
    ///
    /// # Arguments
    /// * `shape`, `numbers`: the input `[1, channels, rows, columns]`, row-major.
    ///
    /// # Returns
    /// The outputs in the order of `outputs` in [`Self::load`].
    ///
    /// # Errors
    /// [`NetworkError::Run`], [`NetworkError::NotFinite`].
    pub fn run(&mut self, shape: [usize; 4], numbers: Vec<f32>) -> Result<Vec<Tensor>, NetworkError> {
        let outputs = match &mut self.loaded {
            Loaded::OnnxRuntime(session) => session.run(shape, numbers, &self.outputs)?,
            Loaded::Rten(network) => network.run(shape, numbers)?,
        };
        for (name, tensor) in self.outputs.iter().zip(&outputs) {
            if !tensor.data.iter().all(|number| number.is_finite()) {
                return Err(NetworkError::NotFinite(name.clone()));
            }
        }
        Ok(outputs)
    }
}
