//! Named tensors of a network, from a safetensors file.
//!
//! Source: github.com/huggingface/safetensors (format).

use safetensors::{Dtype, SafeTensorError, SafeTensors};
use std::collections::BTreeMap;

/// Weights of a network by name.
///
/// # Example
/// ```
/// use vision::features::StateDict;
///
/// let header = br#"{"bias":{"dtype":"F32","shape":[2],"data_offsets":[0,8]}}"#;
/// let numbers = [0.5_f32, -1.0].into_iter().flat_map(f32::to_le_bytes);
/// let file: Vec<u8> =
///     (header.len() as u64).to_le_bytes().into_iter().chain(*header).chain(numbers).collect();
/// assert_eq!(StateDict::read(&file)?.get("bias", &[2])?, [0.5, -1.0]);
/// # Ok::<(), vision::features::StateDictError>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StateDict {
    tensors: BTreeMap<String, Tensor>,
}

/// Numbers in row-major order.
#[derive(Clone, Debug, PartialEq)]
struct Tensor {
    shape: Vec<usize>,
    data: Vec<f32>,
}

/// Why a file of weights cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StateDictError {
    /// The file is not a safetensors file, or is damaged.
    #[error("not a safetensors file, or damaged: {0}")]
    Format(#[from] SafeTensorError),
    /// A tensor that the network needs is missing.
    #[error("tensor {0} is missing")]
    Missing(String),
    /// A tensor has the wrong shape.
    #[error("tensor {name} has the shape {found:?}; the network needs {needed:?}")]
    Shape {
        /// Name of the tensor.
        name: String,
        /// Its shape.
        found: Vec<usize>,
        /// The shape that the network needs.
        needed: Vec<usize>,
    },
    /// A tensor has the wrong number of axes.
    #[error("tensor {name} has the shape {found:?}; the network needs {needed} axes")]
    Axes {
        /// Name of the tensor.
        name: String,
        /// Its shape.
        found: Vec<usize>,
        /// The number of axes that the network needs.
        needed: usize,
    },
    /// A tensor holds NaN or infinity.
    #[error("tensor {0} holds numbers that are not finite")]
    NotFinite(String),
}

impl StateDict {
    /// Reads the bytes of a safetensors file. Tensors that are not `f32` (batch counters) are skipped.
    ///
    /// # Errors
    /// [`StateDictError::Format`].
    pub fn read(bytes: &[u8]) -> Result<Self, StateDictError> {
        let file = SafeTensors::deserialize(bytes)?;
        let tensors = file.iter().filter(|(_, view)| view.dtype() == Dtype::F32).map(|(name, view)| {
            let data = view.data().as_chunks::<4>().0.iter().map(|&number| f32::from_le_bytes(number));
            (name.to_owned(), Tensor { shape: view.shape().to_vec(), data: data.collect() })
        });
        Ok(Self { tensors: tensors.collect() })
    }

    /// The shape of a tensor with a given number of axes.
    ///
    /// # Errors
    /// [`StateDictError::Missing`], [`StateDictError::Axes`].
    pub fn shape<const AXES: usize>(&self, name: &str) -> Result<[usize; AXES], StateDictError> {
        let tensor = self.tensors.get(name).ok_or_else(|| StateDictError::Missing(name.to_owned()))?;
        let wrong = |_| {
            let found = tensor.shape.clone();
            StateDictError::Axes { name: name.to_owned(), found, needed: AXES }
        };
        tensor.shape.as_slice().try_into().map_err(wrong)
    }

    /// The numbers of a tensor of a given shape, row-major.
    ///
    /// # Errors
    /// [`StateDictError::Missing`], [`StateDictError::Shape`], [`StateDictError::NotFinite`].
    pub fn get(&self, name: &str, shape: &[usize]) -> Result<&[f32], StateDictError> {
        let tensor = self.tensors.get(name).ok_or_else(|| StateDictError::Missing(name.to_owned()))?;
        if tensor.shape != shape {
            let (found, needed) = (tensor.shape.clone(), shape.to_vec());
            return Err(StateDictError::Shape { name: name.to_owned(), found, needed });
        }
        if !tensor.data.iter().all(|number| number.is_finite()) {
            return Err(StateDictError::NotFinite(name.to_owned()));
        }
        Ok(&tensor.data)
    }
}
