//! The network of XFeat.
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
//! Unless noted, every layer is a 3x3 convolution, batch normalization (folded into the convolution here) and ReLU. The mean and
//! the 1x1 convolution of the skip are one 4x4 convolution of stride 4: the same numbers.
//!
//! Source: Potje, Cadar, Araujo, Martins & Nascimento, "XFeat: Accelerated Features for Lightweight Image Matching",
//! CVPR 2024.

use crate::features::layers::reader::Reader;
use crate::features::layers::resampling::{add_enlarged, split};
use crate::features::layers::{Convolution, Layer, Map};
use crate::features::state_dict::{StateDict, StateDictError};

/// Columns and rows of the image must be multiples of this.
pub(super) const MULTIPLE: usize = 32;
/// Side of a cell, pixels: the outputs have one value per cell.
pub(super) const CELL: usize = 8;
/// Numbers of a descriptor.
pub(super) const DIMENSION: usize = 64;
/// Channels of the keypoint head: one per pixel of a cell, and one for "no keypoint".
pub(super) const KEYPOINT_CHANNELS: usize = CELL * CELL + 1;

/// The layers; memory is reused from image to image.
pub struct XfeatNetwork {
    /// 4x4 phases of the image.
    quarter: Map,
    /// 8x8 phases of the image.
    cells: Map,
    pyramid: Map,
    skip: Step,
    blocks: [Vec<Step>; 5],
    fusion: Vec<Step>,
    reliability: Vec<Step>,
    keypoints: Vec<Step>,
}

/// A layer with its output.
struct Step {
    stride: usize,
    layer: Layer,
    relu: bool,
    /// The phases of the input, where the stride is two.
    phases: Map,
    output: Map,
}

impl XfeatNetwork {
    /// # Errors
    /// [`StateDictError`] if a tensor is missing, has a wrong shape or is not finite.
    pub fn new(weights: &StateDict) -> Result<Self, StateDictError> {
        let reader = Reader(weights);
        let block = |name: &str, inputs, layers: &[_]| Step::block(&reader, name, inputs, layers);
        let with_last = |mut steps: Vec<Step>, name: &str, outputs| {
            let layer = reader.layer(name, [outputs, 64, 1, 1])?;
            steps.push(Step::new(layer, 1, false));
            Ok::<_, StateDictError>(steps)
        };
        let fusion = block("block_fusion", 64, &[(64, 3, 1), (64, 3, 1)])?;
        let reliability = block("heatmap_head", 64, &[(64, 1, 1), (64, 1, 1)])?;
        let keypoints = block("keypoint_head", CELL * CELL, &[(64, 1, 1), (64, 1, 1), (64, 1, 1)])?;
        Ok(Self {
            quarter: Map::default(),
            cells: Map::default(),
            pyramid: Map::default(),
            skip: Step::new(Layer::new(&skip(weights)?), 1, false),
            blocks: [
                block("block1", 1, &[(4, 3, 1), (8, 3, 2), (8, 3, 1), (24, 3, 2)])?,
                block("block2", 24, &[(24, 3, 1), (24, 3, 1)])?,
                block("block3", 24, &[(64, 3, 2), (64, 3, 1), (64, 1, 1)])?,
                block("block4", 64, &[(64, 3, 2), (64, 3, 1), (64, 3, 1)])?,
                block("block5", 64, &[(128, 3, 2), (128, 3, 1), (128, 3, 1), (64, 1, 1)])?,
            ],
            fusion: with_last(fusion, "block_fusion.2", DIMENSION)?,
            reliability: with_last(reliability, "heatmap_head.2", 1)?,
            keypoints: with_last(keypoints, "keypoint_head.3", KEYPOINT_CHANNELS)?,
        })
    }

    /// # Arguments
    /// * `image`: one channel of mean 0 and variance 1; its rows and columns are multiples of 32.
    ///
    /// # Returns
    /// Descriptors (64 channels, of any length), logits of keypoints (65 channels) and the reliability (0 to 1) of each cell of 8x8 pixels.
    pub fn run(&mut self, image: &Map) -> [&Map; 3] {
        let [block1, block2, block3, block4, block5] = &mut self.blocks;
        split::<4>(image, &mut self.quarter);
        let first = Step::run_all(block1, image);
        self.skip.layer.run(&self.quarter, Some(first), false, &mut self.skip.output);
        let second = Step::run_all(block2, &self.skip.output);
        let a = Step::run_all(block3, second);
        let b = Step::run_all(block4, a);
        let c = Step::run_all(block5, b);
        self.pyramid.clone_from(a);
        add_enlarged::<2>(b, &mut self.pyramid);
        add_enlarged::<4>(c, &mut self.pyramid);
        let descriptors = Step::run_all(&mut self.fusion, &self.pyramid);
        Step::run_all(&mut self.reliability, descriptors);
        let reliability = &mut self.reliability[2].output;
        reliability.apply(|number| 1.0 / (1.0 + (-number).exp()));
        split::<CELL>(image, &mut self.cells);
        let keypoints = Step::run_all(&mut self.keypoints, &self.cells);
        [descriptors, keypoints, reliability]
    }
}

impl Step {
    fn new(layer: Layer, stride: usize, relu: bool) -> Self {
        Self { stride, layer, relu, phases: Map::default(), output: Map::default() }
    }

    /// A sequence of layers, each given by output channels, kernel size and stride.
    fn block(
        reader: &Reader<'_>,
        name: &str,
        mut inputs: usize,
        layers: &[(usize, usize, usize)],
    ) -> Result<Vec<Self>, StateDictError> {
        let step = |(index, &(outputs, side, stride)): (usize, &(usize, usize, usize))| {
            let name = format!("{name}.{index}.layer");
            let convolution = reader.unbiased(&format!("{name}.0"), [outputs, inputs, side, side])?;
            inputs = outputs;
            let convolution = reader.normalized(convolution, &format!("{name}.1"))?;
            Ok(Self::new(Layer::new(&Convolution { stride, ..convolution }), stride, true))
        };
        layers.iter().enumerate().map(step).collect()
    }

    /// Runs layers one after the other.
    fn run_all<'a>(steps: &'a mut [Self], image: &'a Map) -> &'a Map {
        let mut input = image;
        for step in steps {
            if step.stride == 2 {
                split::<2>(input, &mut step.phases);
                input = &step.phases;
            }
            step.layer.run(input, None, step.relu, &mut step.output);
            input = &step.output;
        }
        input
    }
}

/// Mean over 4x4 pixels, scaled and offset for each channel.
fn skip(weights: &StateDict) -> Result<Convolution, StateDictError> {
    const SIDE: usize = 4;
    let factors = weights.get("skip1.1.weight", &[24, 1, 1, 1])?;
    let bias = weights.get("skip1.1.bias", &[24])?.to_vec();
    let weights = factors.iter().flat_map(|factor| [factor / (SIDE * SIDE) as f32; SIDE * SIDE]).collect();
    let same = Convolution::same([24, 1, SIDE, SIDE], weights, bias);
    Ok(Convolution { stride: SIDE, padding: 0, ..same })
}
