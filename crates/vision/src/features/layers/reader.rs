//! Layers from named tensors, as PyTorch writes them.

use super::{Convolution, Layer};
use crate::features::state_dict::{StateDict, StateDictError};

/// Added to variances, PyTorch's default: all networks here were trained with it.
pub const EPSILON: f32 = 1e-5;

/// Reads layers; each error is of the tensor that it names.
pub struct Reader<'a>(pub &'a StateDict);

impl Reader<'_> {
    /// A convolution with its bias, of stride 1, whose output is as large as its input.
    ///
    /// # Arguments
    /// * `shape`: output channels, input channels, rows and columns of the kernel.
    ///
    /// # Errors
    /// [`StateDictError`]: a tensor is missing, has another shape or is not finite.
    pub fn convolution(&self, name: &str, shape: [usize; 4]) -> Result<Convolution, StateDictError> {
        let bias = self.0.get(&format!("{name}.bias"), &shape[..1])?.to_vec();
        Ok(Convolution { bias, ..self.unbiased(name, shape)? })
    }

    /// A convolution without a bias.
    ///
    /// # Errors
    /// As [`Reader::convolution`].
    pub fn unbiased(&self, name: &str, shape: [usize; 4]) -> Result<Convolution, StateDictError> {
        let weights = self.0.get(&format!("{name}.weight"), &shape)?.to_vec();
        Ok(Convolution::same(shape, weights, vec![0.0; shape[0]]))
    }

    /// As [`Reader::convolution`], ready to run.
    ///
    /// # Errors
    /// As [`Reader::convolution`].
    pub fn layer(&self, name: &str, shape: [usize; 4]) -> Result<Layer, StateDictError> {
        Ok(Layer::new(&self.convolution(name, shape)?))
    }

    /// Folds a batch normalization without factors and offsets into the convolution before it.
    ///
    /// # Errors
    /// As [`Reader::convolution`]; [`StateDictError::NotFinite`] of variances that are not positive.
    pub fn normalized(&self, convolution: Convolution, name: &str) -> Result<Convolution, StateDictError> {
        let of = |what: &str| self.0.get(&format!("{name}.{what}"), &convolution.shape[..1]);
        let (mean, variance) = (of("running_mean")?, of("running_var")?);
        let folded = convolution.normalized(mean, variance, EPSILON);
        if folded.bias.iter().chain(&folded.weights).all(|number| number.is_finite()) {
            Ok(folded)
        } else {
            Err(StateDictError::NotFinite(format!("{name}.running_var")))
        }
    }

    /// As [`Reader::normalized`], with factors and offsets.
    ///
    /// # Errors
    /// As [`Reader::normalized`].
    pub fn scaled(&self, convolution: Convolution, name: &str) -> Result<Convolution, StateDictError> {
        let of = |what: &str| self.0.get(&format!("{name}.{what}"), &convolution.shape[..1]);
        let (factors, offsets) = (of("weight")?, of("bias")?);
        Ok(self.normalized(convolution, name)?.scaled(factors, offsets))
    }
}
