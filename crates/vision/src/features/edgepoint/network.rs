//! The network of EdgePoint2: dense maps of features and of scores.
//!
//! ```text
//! image [1, H, W] (of mean 0 and variance 1; H and W multiples of 32)
//!   block1: c1 (4x4, stride 2), c2, residual c2                          H/2    x1
//!   mean of 2x2                                                          H/4    q
//!   mean of 2x2, block2: residual c3                                     H/8    x2
//!   mean of 4x4, block3: residual c4                                     H/32   x3
//!   scores: conv1(x1) + enlarged conv2(x2) + enlarged conv3(x3) (1x1 each), 3x3, ReLU, 3x3, ReLU, 3x3 to 4 channels:
//!   the 2x2 pixels of each cell of                                       H/2
//! ```
//! A residual layer is `relu(normalized 3x3 (relu(normalized 3x3 (x))) + skip(x))`, with a 1x1 convolution as skip where the number of channels
//! changes. The descriptors are computed from q, x2 and x3 at keypoints only ([`super::describer`]).
//!
//! Source: Yao, He, Hao & Chen, "EdgePoint2: Compact Descriptors for Superior Efficiency and Accuracy", arXiv 2504.17280; the published
//! weights (layer names).

use crate::features::layers::reader::Reader;
use crate::features::layers::resampling::{add_enlarged, average};
use crate::features::layers::{Convolution, Layer, Map};
use crate::features::state_dict::{StateDict, StateDictError};

/// The layers.
pub(super) struct Network {
    first: Layer,
    second: Layer,
    blocks: [Residual; 3],
    /// Of x1, x2 and x3 for the scores.
    scores: [Layer; 3],
    head: [Layer; 3],
}

/// A residual layer.
struct Residual {
    first: Layer,
    second: Layer,
    skip: Option<Layer>,
}

/// What the network computes of an image, and what it needs in between; memory is reused from image to image.
#[derive(Default)]
pub(super) struct Maps {
    /// The normalized image: its 2x2 phases.
    pub image: Map,
    /// At half, eighth and 32nd of the resolution.
    pub features: [Map; 3],
    /// At a quarter of the resolution.
    pub quarter: Map,
    /// Scores: four channels, the pixels of a square of 2x2.
    pub scores: Map,
    eighth: Map,
    thirty_second: Map,
    temporary: [Map; 2],
    coarse_scores: [Map; 2],
    sum: Map,
}

impl Network {
    /// # Errors
    /// [`StateDictError`]: a tensor is missing, has another shape than the others suggest, or is not finite.
    pub fn new(weights: &StateDict) -> Result<Self, StateDictError> {
        let reader = Reader(weights);
        let channels = |name: &str| Ok::<_, StateDictError>(weights.shape::<4>(name)?[0]);
        let c1 = channels("block1.0.layer.0.weight")?;
        let c2 = channels("block1.1.layer.0.weight")?;
        let c3 = channels("block2.layer.0.weight")?;
        let c4 = channels("block3.layer.0.weight")?;
        let detect = channels("conv1.weight")?;
        let head = |name: &str, outputs| reader.layer(name, [outputs, detect, 3, 3]);
        let score = |name: &str, inputs| reader.layer(name, [detect, inputs, 1, 1]);
        let first = reader.unbiased("block1.0.layer.0", [c1, 1, 4, 4])?;
        let first = Convolution { stride: 2, padding: 1, ..first };
        let second = reader.unbiased("block1.1.layer.0", [c2, c1, 3, 3])?;
        Ok(Self {
            first: Layer::new(&reader.scaled(first, "block1.0.layer.1")?),
            second: Layer::new(&reader.scaled(second, "block1.1.layer.1")?),
            blocks: [
                Residual::new(&reader, "block1.2", c2, c2)?,
                Residual::new(&reader, "block2", c2, c3)?,
                Residual::new(&reader, "block3", c3, c4)?,
            ],
            scores: [score("conv1", c2)?, score("conv2", c3)?, score("conv3", c4)?],
            head: [head("score_head.0", detect)?, head("score_head.2", detect)?, head("score_head.4", 4)?],
        })
    }

    /// Computes all maps from `maps.image`.
    pub fn run(&self, maps: &mut Maps) {
        let Maps { image, features: [x1, x2, x3], quarter, scores, eighth, thirty_second, .. } = maps;
        let [a, b] = &mut maps.temporary;
        let [block1, block2, block3] = &self.blocks;
        self.first.run(image, None, true, a);
        self.second.run(a, None, true, b);
        block1.run(b, a, &mut maps.sum, x1);
        average::<2>(x1, quarter);
        average::<2>(quarter, eighth);
        let [coarse, coarsest] = &mut maps.coarse_scores;
        block2.run(eighth, coarse, coarsest, x2);
        average::<4>(x2, thirty_second);
        block3.run(thirty_second, coarse, coarsest, x3);

        self.scores[1].run(x2, None, false, coarse);
        self.scores[2].run(x3, None, false, coarsest);
        maps.sum.reshape(coarse.channels(), x1.rows(), x1.columns());
        maps.sum.clear();
        add_enlarged::<4>(coarse, &mut maps.sum);
        add_enlarged::<16>(coarsest, &mut maps.sum);
        self.scores[0].run(x1, Some(&maps.sum), false, a);
        self.head[0].run(a, None, true, b);
        self.head[1].run(b, None, true, a);
        self.head[2].run(a, None, false, scores);
    }
}

impl Residual {
    fn new(reader: &Reader<'_>, name: &str, inputs: usize, outputs: usize) -> Result<Self, StateDictError> {
        let layer = |at: usize, inputs| {
            let [convolution, norm] = [at, at + 1].map(|at| format!("{name}.layer.{at}"));
            let convolution = reader.unbiased(&convolution, [outputs, inputs, 3, 3])?;
            Ok::<_, StateDictError>(Layer::new(&reader.scaled(convolution, &norm)?))
        };
        let skip = if inputs == outputs {
            None
        } else {
            Some(reader.layer(&format!("{name}.skip"), [outputs, inputs, 1, 1])?)
        };
        Ok(Self { first: layer(0, inputs)?, second: layer(3, outputs)?, skip })
    }

    fn run(&self, input: &Map, between: &mut Map, skipped: &mut Map, output: &mut Map) {
        self.first.run(input, None, true, between);
        match &self.skip {
            Some(skip) => {
                skip.run(input, None, false, skipped);
                self.second.run(between, Some(skipped), true, output);
            }
            None => self.second.run(between, Some(input), true, output),
        }
    }
}
