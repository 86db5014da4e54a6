//! Why a network cannot be loaded or run.

use crate::features::state_dict::StateDictError;

/// An error of an inference engine.
pub type EngineError = Box<dyn std::error::Error + Send + Sync>;

/// Why a network cannot be loaded or run.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NetworkError {
    /// The weights cannot be used.
    #[error(transparent)]
    Weights(#[from] StateDictError),
    /// The bytes are not an ONNX network that the engine can run.
    #[error("not an ONNX network that can be run: {0}")]
    Load(EngineError),
    /// The network has no tensor of that name.
    #[error("the network has no tensor named {0}")]
    Tensor(String),
    /// The engine is not available.
    #[error("the library of ONNX Runtime was not found")]
    NoEngine,
    /// Running it failed.
    #[error("the network failed: {0}")]
    Run(EngineError),
    /// The network does not have the expected number of outputs.
    #[error("the network has {found} outputs; {needed} are needed")]
    Outputs {
        /// Number of outputs.
        found: usize,
        /// Number needed.
        needed: usize,
    },
    /// An output has a wrong shape.
    #[error("the network's output {name} has the shape {found:?}; {needed:?} is needed")]
    Shape {
        /// Name of the output.
        name: String,
        /// Its shape.
        found: Vec<usize>,
        /// The shape that is needed.
        needed: Vec<usize>,
    },
    /// An output holds NaN or infinity.
    #[error("the network's output {0} holds numbers that are not finite")]
    NotFinite(String),
}
