//! Runs an ONNX network on the processor, in one thread: images of a robot come one at a time, and the other cores
//! have work of their own.

use super::state_dict::Tensor;
use rten::{Model, ModelOptions, NodeId, RunOptions, ThreadPool};
use rten_tensor::prelude::*;
use rten_tensor::{NdTensor, Tensor as RtenTensor};
use std::sync::Arc;

/// Why a network cannot be loaded or run.
#[derive(Debug, thiserror::Error)]
pub enum NetworkError {
    /// The bytes are no ONNX file that the runtime understands.
    #[error("it is no ONNX network that can be run: {0}")]
    Load(String),
    /// The network has no tensor of that name.
    #[error("the network has no tensor named {0}")]
    Tensor(String),
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

/// A network with one input image and several output maps.
pub struct Network {
    model: Model,
    input: NodeId,
    outputs: Vec<(String, NodeId)>,
    threads: Arc<ThreadPool>,
}

impl Network {
    /// Loads the bytes of an ONNX file.
    ///
    /// # Arguments
    /// * `input`, `outputs`: the names of the tensors that are given and wanted.
    ///
    /// # Errors
    /// [`NetworkError::Load`], [`NetworkError::Tensor`].
    pub fn load(onnx: Vec<u8>, input: &str, outputs: &[&str]) -> Result<Self, NetworkError> {
        let model = ModelOptions::with_all_ops().load(onnx).map_err(|error| NetworkError::Load(error.to_string()))?;
        let node = |name: &str| model.find_node(name).ok_or_else(|| NetworkError::Tensor(name.to_owned()));
        let outputs = outputs.iter().map(|&name| Ok((name.to_owned(), node(name)?))).collect::<Result<_, _>>()?;
        let input = node(input)?;
        Ok(Self { model, input, outputs, threads: Arc::new(ThreadPool::with_num_threads(1)) })
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
    pub fn run(&self, shape: [usize; 4], numbers: Vec<f32>) -> Result<Vec<Tensor>, NetworkError> {
        let failed = |reason: String| NetworkError::Run(reason);
        let image = NdTensor::try_from_data(shape, numbers).map_err(|error| failed(error.to_string()))?;
        let options = RunOptions::default().with_thread_pool(Some(Arc::clone(&self.threads)));
        let wanted: Vec<NodeId> = self.outputs.iter().map(|&(_, node)| node).collect();
        let found = self.model.run(vec![(self.input, image.into())], &wanted, Some(options));
        let found = found.map_err(|error| failed(error.to_string()))?;
        self.outputs
            .iter()
            .zip(found)
            .map(|((name, _), value)| {
                let tensor: RtenTensor<f32> = value.try_into().map_err(|_| failed(format!("{name} is not of f32")))?;
                let shape = tensor.shape().to_vec();
                let data = tensor.into_data();
                if !data.iter().all(|number| number.is_finite()) {
                    return Err(NetworkError::NotFinite(name.clone()));
                }
                Ok(Tensor { shape, data })
            })
            .collect()
    }
}
