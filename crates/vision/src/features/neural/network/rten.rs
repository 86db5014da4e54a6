//! Networks run by the crate `rten`.

use super::error::NetworkError;
use crate::features::tensor::Tensor;
use rten::{Model, ModelOptions, NodeId, RunOptions, ThreadPool};
use rten_tensor::prelude::*;
use rten_tensor::{NdTensor, Tensor as RtenTensor};
use std::sync::Arc;

/// A loaded network.
pub(super) struct Session {
    model: Model,
    input: NodeId,
    outputs: Vec<NodeId>,
    threads: Arc<ThreadPool>,
}

impl Session {
    pub fn load(onnx: Vec<u8>, input: &str, outputs: &[&str]) -> Result<Self, NetworkError> {
        let mut options = ModelOptions::with_all_ops();
        options.prepack_weights(true);
        let model = options.load(onnx).map_err(|error| NetworkError::Load(error.into()))?;
        let node = |name: &str| model.find_node(name).ok_or_else(|| NetworkError::Tensor(name.to_owned()));
        let outputs = outputs.iter().map(|&name| node(name)).collect::<Result<_, _>>()?;
        let input = node(input)?;
        Ok(Self { model, input, outputs, threads: Arc::new(ThreadPool::with_num_threads(1)) })
    }

    pub fn run(&self, shape: [usize; 4], numbers: Vec<f32>) -> Result<Vec<Tensor>, NetworkError> {
        let image =
            NdTensor::try_from_data(shape, numbers).map_err(|error| NetworkError::Run(error.into()))?;
        let options = RunOptions::default().with_thread_pool(Some(Arc::clone(&self.threads)));
        let found = self.model.run(vec![(self.input, image.into())], &self.outputs, Some(options));
        let found = found.map_err(|error| NetworkError::Run(error.into()))?;
        found
            .into_iter()
            .map(|value| {
                let tensor: RtenTensor<f32> =
                    value.try_into().map_err(|_| NetworkError::Run("an output is not f32".into()))?;
                Ok(Tensor { shape: tensor.shape().to_vec(), data: tensor.into_data() })
            })
            .collect()
    }
}
