//! The network of R2D2.
//!
//! ```text
//! image [3, H, W] (normalized by the colours of the training images)
//!   32, 32, 64, 64 and 128, 128 channels: 3x3; dilated by 2 from the fourth layer on, by 4 in the sixth
//!   128, 128, 128 channels: 2x2, dilated by 4, 8 and 16, without ReLU
//!   x: 128 numbers of each pixel
//! descriptors: x of length 1; reliability: softmax of two, and repeatability: softplus of one linear function of the squares of x
//! ```
//! Batch normalization after each layer but the last is folded into it.
//!
//! Source: Revaud, Weinzaepfel, De Souza & Humenberger, "R2D2: Repeatable and Reliable Detector and Descriptor",
//! NeurIPS 2019; the names of the published weights.

use crate::features::layers::reader::Reader;
use crate::features::layers::{Convolution, Layer, Map};
use crate::features::state_dict::{StateDict, StateDictError};

/// Numbers of a descriptor.
pub(super) const DIMENSION: usize = 128;

/// Position among the published operations, inputs, outputs, kernel size and dilation of each layer.
const LAYERS: [(usize, [usize; 4]); 9] = [
    (0, [3, 32, 3, 1]),
    (3, [32, 32, 3, 1]),
    (6, [32, 64, 3, 1]),
    (9, [64, 64, 3, 2]),
    (12, [64, 128, 3, 2]),
    (15, [128, 128, 3, 4]),
    (18, [128, 128, 2, 4]),
    (20, [128, 128, 2, 8]),
    (22, [128, DIMENSION, 2, 16]),
];
/// Number of layers with ReLU, the first ones.
const RELUS: usize = 6;

/// The layers; memory is reused from image to image.
pub struct R2d2Network {
    layers: Vec<Layer>,
    /// Two numbers for the reliability, one for the repeatability.
    confidence: Layer,
    maps: [Map; 2],
    confidences: Map,
}

impl R2d2Network {
    /// # Errors
    /// [`StateDictError`] if a tensor is missing, has a wrong shape or is not finite.
    pub fn new(weights: &StateDict) -> Result<Self, StateDictError> {
        let reader = Reader(weights);
        let layer = |(number, &(at, [inputs, outputs, side, dilation])): (usize, &(usize, [usize; 4]))| {
            let convolution = reader.convolution(&format!("ops.{at}"), [outputs, inputs, side, side])?;
            let padding = (side - 1) * dilation / 2;
            let convolution = Convolution { padding, dilation, ..convolution };
            if number + 1 == LAYERS.len() {
                return Ok(Layer::new(&convolution));
            }
            Ok(Layer::new(&reader.normalized(convolution, &format!("ops.{}", at + 1))?))
        };
        let layers = LAYERS.iter().enumerate().map(layer).collect::<Result<_, StateDictError>>()?;
        let reliability = reader.convolution("clf", [2, DIMENSION, 1, 1])?;
        let repeatability = reader.convolution("sal", [1, DIMENSION, 1, 1])?;
        let confidence = Convolution::same(
            [3, DIMENSION, 1, 1],
            [reliability.weights, repeatability.weights].concat(),
            [reliability.bias, repeatability.bias].concat(),
        );
        let confidence = Layer::new(&confidence);
        Ok(Self { layers, confidence, maps: Default::default(), confidences: Map::default() })
    }

    /// # Arguments
    /// * `image`: three channels, normalized by the colours of the training images.
    ///
    /// # Returns
    /// Descriptors of each pixel (128 channels, of any length); reliability and repeatability (two channels, 0 to 1).
    pub fn run(&mut self, image: &Map) -> [&Map; 2] {
        let [x, other] = &mut self.maps;
        x.clone_from(image);
        for (number, layer) in self.layers.iter().enumerate() {
            layer.run(x, None, number < RELUS, other);
            std::mem::swap(x, other);
        }
        other.clone_from(x);
        other.apply(|number| number * number);
        self.confidence.run(other, None, false, &mut self.confidences);
        let confidences = &mut self.confidences;
        for y in 0..confidences.rows() {
            for column in 0..confidences.columns() {
                let [unreliable, reliable, repeatable] =
                    [0, 1, 2].map(|channel| confidences.row(channel, y)[column]);
                confidences.row_mut(0, y)[column] = 1.0 / (1.0 + (unreliable - reliable).exp());
                let positive = softplus(repeatable);
                confidences.row_mut(1, y)[column] = positive / (1.0 + positive);
            }
        }
        [x, confidences]
    }
}

/// ln(1 + e^x).
fn softplus(x: f32) -> f32 {
    x.max(0.0) + (-x.abs()).exp().ln_1p()
}
