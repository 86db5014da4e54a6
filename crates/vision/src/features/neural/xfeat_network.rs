//! The network of XFeat as an ONNX graph.
//!
//! ```text
//! image [1, H, W] (of mean 0 and variance 1; H and W multiples of 32)
//!   block1: 4, 8 (stride 2), 8, 24 (stride 2) channels   + skip: mean of 4x4 pixels, 24 channels       H/4
//!   block2: 24, 24                                                                                  H/4
//!   block3: 64 (stride 2), 64, 64 (1x1)                                                             H/8   a
//!   block4: 64 (stride 2), 64, 64                                                                   H/16  b
//!   block5: 128 (stride 2), 128, 128, 64 (1x1)                                                      H/32  c
//!   block_fusion(a + upsampled b + upsampled c): 64, 64, 64 (1x1, plain)  -> descriptors [64, H/8, W/8]
//!   heatmap_head(descriptors): 64, 64, 1 (1x1), sigmoid                 -> reliability [1, H/8, W/8]
//!   keypoint_head(each 8x8 pixels as 64 channels): 64, 64, 64, 65 (1x1) -> keypoints   [65, H/8, W/8]
//! ```
//! Unless noted, every layer is a 3x3 convolution, batch normalization (folded into the convolution here) and ReLU. The mean and the 1x1 convolution of the skip are one 4x4 convolution of stride 4, the
//! first layer of the keypoint head is one 8x8 convolution of stride 8: the same numbers.
//!
//! Source: Potje, Cadar, Araujo, Martins & Nascimento, "XFeat: Accelerated Features for Lightweight Image Matching",
//! CVPR 2024.

use super::graph::{Convolution, Graph};
use crate::features::state_dict::{StateDict, StateDictError};

/// Columns and rows of the image must be multiples of this.
pub(super) const MULTIPLE: usize = 32;
/// Side of a cell, pixels: the outputs have one value per cell.
pub(super) const CELL: usize = 8;
/// Numbers of a descriptor.
pub(super) const DIMENSION: usize = 64;
/// Channels of the keypoint head: one per pixel of a cell, and one for "no keypoint".
pub(super) const KEYPOINT_CHANNELS: usize = CELL * CELL + 1;
/// Added to variances, as in the training.
const EPSILON: f32 = 1e-5;

/// Name of the input tensor.
pub(super) const INPUT: &str = "image";
/// Names of the output tensors.
pub(super) const OUTPUTS: [&str; 3] = ["descriptors", "keypoints", "reliability"];

/// Writes the network as an ONNX file in memory.
///
/// # Errors
/// [`StateDictError`] if a tensor is missing, has a wrong shape or is not finite.
pub fn write(weights: &StateDict) -> Result<Vec<u8>, StateDictError> {
    let mut network = Writer { weights, graph: Graph::default() };
    network.graph.input(INPUT, 1);
    network.backbone_and_heads()?;
    for (name, channels) in OUTPUTS.iter().zip([DIMENSION, KEYPOINT_CHANNELS, 1]) {
        network.graph.output(name, channels);
    }
    Ok(network.graph.write())
}

struct Writer<'a> {
    weights: &'a StateDict,
    graph: Graph,
}

impl Writer<'_> {
    fn backbone_and_heads(&mut self) -> Result<(), StateDictError> {
        let [descriptors, keypoints, reliability] = OUTPUTS;
        let block1 = self.block("block1", INPUT, 1, &[(4, 3, 1), (8, 3, 2), (8, 3, 1), (24, 3, 2)])?;
        let skip = self.skip()?;
        let quarter = self.graph.add(&block1, &skip, "quarter");
        let block2 = self.block("block2", &quarter, 24, &[(24, 3, 1), (24, 3, 1)])?;
        let a = self.block("block3", &block2, 24, &[(64, 3, 2), (64, 3, 1), (64, 1, 1)])?;
        let b = self.block("block4", &a, 64, &[(64, 3, 2), (64, 3, 1), (64, 3, 1)])?;
        let c = self.block("block5", &b, 64, &[(128, 3, 2), (128, 3, 1), (128, 3, 1), (64, 1, 1)])?;

        let b = self.graph.upsample(&b, "block4.upsampled", 2);
        let c = self.graph.upsample(&c, "block5.upsampled", 4);
        let sum = self.graph.add(&a, &b, "pyramid.partial");
        let sum = self.graph.add(&sum, &c, "pyramid");
        let fused = self.block("block_fusion", &sum, 64, &[(64, 3, 1), (64, 3, 1)])?;
        self.plain(&fused, "block_fusion.2", descriptors, DIMENSION)?;

        let head = self.block("heatmap_head", descriptors, 64, &[(64, 1, 1), (64, 1, 1)])?;
        let logit = self.plain(&head, "heatmap_head.2", "reliability.logit", 1)?;
        self.graph.sigmoid(&logit, reliability);

        let cells = self.cells()?;
        let second = self.layer("keypoint_head.1", &cells, 64, (64, 1, 1))?;
        let third = self.layer("keypoint_head.2", &second, 64, (64, 1, 1))?;
        self.plain(&third, "keypoint_head.3", keypoints, KEYPOINT_CHANNELS)?;
        Ok(())
    }

    /// A sequence of layers, each given by output channels, kernel size and stride.
    fn block(
        &mut self,
        name: &str,
        input: &str,
        channels: usize,
        layers: &[(usize, usize, usize)],
    ) -> Result<String, StateDictError> {
        let (mut tensor, mut channels) = (input.to_owned(), channels);
        for (index, &layer) in layers.iter().enumerate() {
            tensor = self.layer(&format!("{name}.{index}"), &tensor, channels, layer)?;
            channels = layer.0;
        }
        Ok(tensor)
    }

    /// Convolution, normalization, ReLU.
    fn layer(
        &mut self,
        name: &str,
        input: &str,
        channels: usize,
        (outputs, side, stride): (usize, usize, usize),
    ) -> Result<String, StateDictError> {
        let shape = [outputs, channels, side, side];
        let weights = self.weights.get(&format!("{name}.layer.0.weight"), &shape)?;
        self.normalized_relu(name, input, shape, weights, stride, side / 2)
    }

    /// The first layer of the keypoint head: 64 channels, each one pixel of a cell.
    fn cells(&mut self) -> Result<String, StateDictError> {
        let name = "keypoint_head.0";
        let pixels = CELL * CELL;
        let weights = self.weights.get(&format!("{name}.layer.0.weight"), &[64, pixels, 1, 1])?;
        self.normalized_relu(name, INPUT, [64, 1, CELL, CELL], weights, CELL, 0)
    }

    fn normalized_relu(
        &mut self,
        name: &str,
        input: &str,
        shape: [usize; 4],
        weights: &[f32],
        stride: usize,
        padding: usize,
    ) -> Result<String, StateDictError> {
        let outputs = shape[0];
        let mean = self.weights.get(&format!("{name}.layer.1.running_mean"), &[outputs])?;
        let variance = self.weights.get(&format!("{name}.layer.1.running_var"), &[outputs])?;
        let bias = vec![0.0; outputs];
        let convolution = Convolution { shape, weights: weights.to_vec(), bias, stride, padding }
            .normalized(mean, variance, EPSILON);
        if !convolution.bias.iter().all(|number| number.is_finite()) {
            return Err(StateDictError::NotFinite(format!("{name}.layer.1.running_var")));
        }
        let sum = self.graph.convolve(input, &format!("{name}.sum"), &convolution);
        Ok(self.graph.relu(&sum, name))
    }

    /// A 1x1 convolution of 64 channels without normalization and ReLU.
    fn plain(
        &mut self,
        input: &str,
        name: &str,
        output: &str,
        outputs: usize,
    ) -> Result<String, StateDictError> {
        let shape = [outputs, 64, 1, 1];
        let weights = self.weights.get(&format!("{name}.weight"), &shape)?.to_vec();
        let bias = self.weights.get(&format!("{name}.bias"), &[outputs])?.to_vec();
        let convolution = Convolution { shape, weights, bias, stride: 1, padding: 0 };
        Ok(self.graph.convolve(input, output, &convolution))
    }

    /// Mean over 4x4 pixels, scaled and offset for each channel.
    fn skip(&mut self) -> Result<String, StateDictError> {
        const SIDE: usize = 4;
        let factors = self.weights.get("skip1.1.weight", &[24, 1, 1, 1])?;
        let weights =
            factors.iter().flat_map(|factor| [factor / (SIDE * SIDE) as f32; SIDE * SIDE]).collect();
        let bias = self.weights.get("skip1.1.bias", &[24])?.to_vec();
        let convolution = Convolution { shape: [24, 1, SIDE, SIDE], weights, bias, stride: SIDE, padding: 0 };
        Ok(self.graph.convolve(INPUT, "skip", &convolution))
    }
}
