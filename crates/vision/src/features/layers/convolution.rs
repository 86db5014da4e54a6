//! Parameters of a convolution.

/// Parameters of a convolution.
#[derive(Clone, Debug, PartialEq)]
pub struct Convolution {
    /// `[output channels, input channels, rows, columns]` of the kernel.
    pub shape: [usize; 4],
    /// The kernel.
    pub weights: Vec<f32>,
    /// One number per output channel.
    pub bias: Vec<f32>,
    /// Stride in both directions, pixels.
    pub stride: usize,
    /// Zero padding on every side, pixels.
    pub padding: usize,
    /// Distance between the pixels that neighbouring weights of the kernel belong to.
    pub dilation: usize,
}

impl Convolution {
    /// A convolution without dilation and with stride 1, whose output is as large as its input.
    pub fn same(shape: [usize; 4], weights: Vec<f32>, bias: Vec<f32>) -> Self {
        Self { shape, weights, bias, stride: 1, padding: shape[2] / 2, dilation: 1 }
    }

    /// Folds a batch normalization with fixed mean and variance of each output channel into the convolution.
    ///
    /// # Panics
    /// If the number of means or variances is not the number of output channels.
    pub fn normalized(mut self, mean: &[f32], variance: &[f32], epsilon: f32) -> Self {
        for (bias, mean) in self.bias.iter_mut().zip(mean) {
            *bias -= mean;
        }
        let factors: Vec<f32> = variance.iter().map(|variance| (variance + epsilon).sqrt().recip()).collect();
        self.scaled(&factors, &vec![0.0; mean.len()])
    }

    /// Multiplies each output channel by its factor and adds its offset.
    ///
    /// # Panics
    /// If the number of factors or offsets is not the number of output channels.
    pub fn scaled(mut self, factors: &[f32], offsets: &[f32]) -> Self {
        let [outputs, ..] = self.shape;
        assert!(factors.len() == outputs && offsets.len() == outputs, "one factor and offset per channel");
        let kernel = self.weights.len() / outputs;
        for (channel, (factor, offset)) in factors.iter().zip(offsets).enumerate() {
            self.bias[channel] = self.bias[channel] * factor + offset;
            for weight in &mut self.weights[channel * kernel..(channel + 1) * kernel] {
                *weight *= factor;
            }
        }
        self
    }
}
