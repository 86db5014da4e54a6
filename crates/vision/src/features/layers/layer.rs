//! Convolutions of feature maps.

use super::convolution::Convolution;
use super::map::{BLOCK, BORDER, Map};
use super::multiply_add;
use pulp::{Arch, Scalar128b, Simd, WithSimd};

/// Output channels that are computed together.
const TOGETHER: usize = 4;

/// A convolution as the processor computes it: for each output channel a weighted sum of shifted rows of the input.
///
/// The input of a convolution of stride s is a map whose channels are the s x s phases of each channel
/// ([`Layer::phase`]); its own stride is then one.
///
/// # Example
/// ```
/// use vision::features::layers::{Convolution, Layer, Map};
///
/// // Each pixel with its two neighbours in the row.
/// let weights = vec![0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0];
/// let sums = Convolution::same([1, 1, 3, 3], weights, vec![0.0]);
/// let (mut input, mut output) = (Map::zeros(1, 2, 4), Map::default());
/// input.row_mut(0, 1).copy_from_slice(&[1.0, 2.0, 3.0, 4.0]);
/// Layer::new(&sums).run(&input, None, false, &mut output);
/// assert_eq!(output.row(0, 1), [3.0, 6.0, 9.0, 7.0]);
/// ```
#[derive(Clone, Debug)]
pub struct Layer {
    /// Output channels.
    outputs: usize,
    /// Channels of the input map.
    inputs: usize,
    /// Channel, and rows down and columns to the right, of each summand.
    taps: Vec<(usize, [isize; 2])>,
    /// Weights of four output channels for each tap, of the first four output channels first.
    weights: Vec<[f32; TOGETHER]>,
    bias: Vec<[f32; TOGETHER]>,
}

impl Layer {
    /// Arranges the weights.
    ///
    /// # Panics
    /// If the kernel reaches further than eight rows or columns (of phases) beyond the map.
    pub fn new(convolution: &Convolution) -> Self {
        let [outputs, inputs, height, width] = convolution.shape;
        let stride = convolution.stride;
        let place = |at: usize| {
            let at = (at * convolution.dilation).cast_signed() - convolution.padding.cast_signed();
            let s = stride.cast_signed();
            (at.rem_euclid(s).cast_unsigned(), at.div_euclid(s))
        };
        let mut taps = Vec::new();
        for channel in 0..inputs {
            for y in 0..height {
                for x in 0..width {
                    let ((phase_y, down), (phase_x, right)) = (place(y), place(x));
                    let reach = down.unsigned_abs().max(right.unsigned_abs());
                    assert!(reach <= BORDER, "the kernel reaches beyond the border");
                    taps.push((Self::phase(stride, channel, [phase_x, phase_y]), [down, right]));
                }
            }
        }
        let of = |numbers: &[f32], output: usize, at: usize, count: usize| {
            if output < outputs { numbers[output * count + at] } else { 0.0 }
        };
        let mut weights = Vec::new();
        let mut bias = Vec::new();
        for first in (0..outputs).step_by(TOGETHER) {
            for tap in 0..taps.len() {
                weights.push(std::array::from_fn(|o| of(&convolution.weights, first + o, tap, taps.len())));
            }
            bias.push(std::array::from_fn(|o| of(&convolution.bias, first + o, 0, 1)));
        }
        Self { outputs, inputs: inputs * stride * stride, taps, weights, bias }
    }

    /// The channel that holds the pixels `[x, y]` of each square of `stride` x `stride` pixels of a channel.
    pub fn phase(stride: usize, channel: usize, [x, y]: [usize; 2]) -> usize {
        (channel * stride + y) * stride + x
    }

    /// `output = convolution(input) + added`, then the negative numbers to zero if `relu`.
    ///
    /// # Panics
    /// If the input has other channels than the convolution, or `added` another shape than the output.
    pub fn run(&self, input: &Map, added: Option<&Map>, relu: bool, output: &mut Map) {
        assert_eq!(input.channels(), self.inputs, "input channels");
        output.reshape(self.outputs, input.rows(), input.columns());
        if let Some(added) = added {
            let shape = |map: &Map| [map.channels(), map.rows(), map.columns()];
            assert_eq!(shape(added), shape(output), "shape of what is added");
        }
        let offsets: Vec<usize> = self.taps.iter().map(|&(channel, at)| input.offset(channel, at)).collect();
        let work = Work { layer: self, offsets: &offsets, input, added, relu, output };
        match Arch::new() {
            Arch::Scalar => Scalar128b.vectorize(Rows::<false>(work)),
            arch => arch.dispatch(Rows::<true>(work)),
        }
    }
}

struct Work<'a> {
    layer: &'a Layer,
    offsets: &'a [usize],
    input: &'a Map,
    added: Option<&'a Map>,
    relu: bool,
    output: &'a mut Map,
}

/// All rows; `FUSED`: products and sums are rounded once, by one instruction.
struct Rows<'a, const FUSED: bool>(Work<'a>);

impl<const FUSED: bool> WithSimd for Rows<'_, FUSED> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Work { layer, offsets, input, added, relu, output } = self.0;
        for y in 0..input.rows() {
            let around = input.around_row(y);
            for (group, bias) in layer.bias.iter().enumerate() {
                let weights = &layer.weights[group * offsets.len()..][..offsets.len()];
                let channels = TOGETHER.min(layer.outputs - group * TOGETHER);
                for x in (0..input.columns()).step_by(BLOCK) {
                    let step = 3 * S::F32_LANES;
                    for x in (x..x + BLOCK).step_by(step) {
                        let mut sums = bias.map(|bias| [simd.splat_f32s(bias); 3]);
                        if let Some(added) = added {
                            let (added, stride) = added.blocks_of_row(y);
                            for (o, sums) in sums.iter_mut().enumerate().take(channels) {
                                let row = &added[(group * TOGETHER + o) * stride + x..][..step];
                                let (row, _) = S::as_simd_f32s(row);
                                for (sum, &number) in sums.iter_mut().zip(row) {
                                    *sum = simd.add_f32s(*sum, number);
                                }
                            }
                        }
                        for (&offset, weights) in offsets.iter().zip(weights) {
                            let (row, _) = S::as_simd_f32s(&around[offset + x..][..step]);
                            let [a, b, c] = [row[0], row[1], row[2]];
                            for (sums, &weight) in sums.iter_mut().zip(weights) {
                                let weight = simd.splat_f32s(weight);
                                sums[0] = multiply_add::<FUSED, S>(simd, weight, a, sums[0]);
                                sums[1] = multiply_add::<FUSED, S>(simd, weight, b, sums[1]);
                                sums[2] = multiply_add::<FUSED, S>(simd, weight, c, sums[2]);
                            }
                        }
                        let zero = simd.splat_f32s(0.0);
                        let (out, stride) = output.blocks_of_row_mut(y);
                        for (o, sums) in sums.iter().enumerate().take(channels) {
                            let row = &mut out[(group * TOGETHER + o) * stride + x..][..step];
                            let (row, _) = S::as_mut_simd_f32s(row);
                            for (out, &sum) in row.iter_mut().zip(sums) {
                                *out = if relu { simd.max_f32s(sum, zero) } else { sum };
                            }
                        }
                    }
                }
            }
            output.clear_right(y);
        }
    }
}
