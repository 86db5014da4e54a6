//! Runs an ONNX network on the processor, in one thread: images of a robot come one at a time, and the other cores
//! have work of their own.
//!
//! Two engines give the same numbers (to 1e-4 of their size): [`Engine::Rten`] is pure Rust and always there;
//! [`Engine::OnnxRuntime`] is faster and needs a shared library. The faster one that is there is taken.

use super::onnxruntime;
use super::state_dict::Tensor;
use rten::{Model, ModelOptions, NodeId, RunOptions, ThreadPool};
use rten_tensor::prelude::*;
use rten_tensor::{NdTensor, Tensor as RtenTensor};
use std::sync::Arc;

/// Why a network cannot be loaded or run.
#[derive(Debug, thiserror::Error)]
pub enum NetworkError {
    /// The bytes are no ONNX file that the engine understands.
    #[error("it is no ONNX network that can be run: {0}")]
    Load(String),
    /// The network has no tensor of that name.
    #[error("the network has no tensor named {0}")]
    Tensor(String),
    /// The engine is not there.
    #[error("the library of ONNX Runtime is not there")]
    NoEngine,
    /// Running it failed.
    #[error("the network failed: {0}")]
    Run(String),
    /// An output has another shape than the network's interface says.
    #[error("the network's output {name} has the shape {found:?}; {needed:?} is needed")]
    Shape {
        /// Which output.
        name: String,
        /// Its shape.
        found: Vec<usize>,
        /// The shape it must have.
        needed: Vec<usize>,
    },
    /// An output holds NaN or infinity.
    #[error("the network's output {0} holds numbers that are not finite")]
    NotFinite(String),
}

/// What runs networks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Engine {
    /// Microsoft's ONNX Runtime, from its shared library.
    OnnxRuntime,
    /// The crate `rten`.
    Rten,
}

impl Engine {
    /// ONNX Runtime where its library is found, else rten.
    ///
    /// The library is looked for once, in this order: the file that `$ORT_DYLIB_PATH` names, `libonnxruntime.so` in
    /// the default folder of weights (where `driftless weights onnxruntime` puts it), and `libonnxruntime.so` where
    /// the system looks for libraries.
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
    Rten(Box<Rten>),
}

impl Network {
    /// Loads the bytes of an ONNX file.
    ///
    /// # Arguments
    /// * `input`, `outputs`: the names of the tensors that are given and wanted.
    ///
    /// # Errors
    /// [`NetworkError::Load`], [`NetworkError::Tensor`], [`NetworkError::NoEngine`].
    pub fn load(onnx: Vec<u8>, input: &str, outputs: &[&str], engine: Engine) -> Result<Self, NetworkError> {
        let loaded = match engine {
            Engine::OnnxRuntime => Loaded::OnnxRuntime(onnxruntime::Session::load(&onnx, input, outputs)?),
            Engine::Rten => Loaded::Rten(Box::new(Rten::load(onnx, input, outputs)?)),
        };
        Ok(Self { outputs: outputs.iter().map(|&name| name.to_owned()).collect(), loaded })
    }

    /// Runs the network.
    ///
    /// # Arguments
    /// * `shape`, `numbers`: the input `[1, channels, rows, columns]`, row-major.
    ///
    /// # Returns
    /// The outputs in the order in which they were named.
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

/// A network that rten runs.
struct Rten {
    model: Model,
    input: NodeId,
    outputs: Vec<NodeId>,
    threads: Arc<ThreadPool>,
}

impl Rten {
    fn load(onnx: Vec<u8>, input: &str, outputs: &[&str]) -> Result<Self, NetworkError> {
        let mut options = ModelOptions::with_all_ops();
        options.prepack_weights(true);
        let model = options.load(onnx).map_err(|error| NetworkError::Load(error.to_string()))?;
        let node = |name: &str| model.find_node(name).ok_or_else(|| NetworkError::Tensor(name.to_owned()));
        let outputs = outputs.iter().map(|&name| node(name)).collect::<Result<_, _>>()?;
        let input = node(input)?;
        Ok(Self { model, input, outputs, threads: Arc::new(ThreadPool::with_num_threads(1)) })
    }

    fn run(&self, shape: [usize; 4], numbers: Vec<f32>) -> Result<Vec<Tensor>, NetworkError> {
        let failed = |reason: String| NetworkError::Run(reason);
        let image = NdTensor::try_from_data(shape, numbers).map_err(|error| failed(error.to_string()))?;
        let options = RunOptions::default().with_thread_pool(Some(Arc::clone(&self.threads)));
        let found = self.model.run(vec![(self.input, image.into())], &self.outputs, Some(options));
        let found = found.map_err(|error| failed(error.to_string()))?;
        found
            .into_iter()
            .map(|value| {
                let tensor: RtenTensor<f32> =
                    value.try_into().map_err(|_| failed("an output is not of f32".to_owned()))?;
                Ok(Tensor { shape: tensor.shape().to_vec(), data: tensor.into_data() })
            })
            .collect()
    }
}
