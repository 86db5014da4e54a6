//! Tensors: input and output of networks, and their weights.

/// Numbers in row-major order.
#[derive(Clone, Debug, PartialEq)]
pub struct Tensor {
    /// Size of each axis; the last axis is contiguous.
    pub shape: Vec<usize>,
    /// The numbers.
    pub data: Vec<f32>,
}
