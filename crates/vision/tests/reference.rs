//! Layers of networks computed one number after the other: nothing is folded, nothing is shared with the program.

use std::collections::BTreeMap;

/// Channels, rows, columns and numbers.
#[derive(Clone)]
pub struct Map {
    pub channels: usize,
    pub rows: usize,
    pub columns: usize,
    pub data: Vec<f32>,
}

/// Shape and numbers by name.
pub type Tensors = BTreeMap<String, (Vec<usize>, Vec<f32>)>;

impl Map {
    pub fn from_fn(
        channels: usize,
        rows: usize,
        columns: usize,
        value: impl Fn(usize, usize, usize) -> f32,
    ) -> Self {
        let mut data = Vec::new();
        for c in 0..channels {
            for y in 0..rows {
                data.extend((0..columns).map(|x| value(c, y, x)));
            }
        }
        Self { channels, rows, columns, data }
    }

    pub fn get(&self, c: usize, y: usize, x: usize) -> f32 {
        self.data[(c * self.rows + y) * self.columns + x]
    }

    /// Zero outside.
    fn padded(&self, c: usize, y: isize, x: isize) -> f32 {
        let inside = y >= 0 && x >= 0 && (y as usize) < self.rows && (x as usize) < self.columns;
        if inside { self.get(c, y as usize, x as usize) } else { 0.0 }
    }

    pub fn map(&self, f: impl Fn(f32) -> f32) -> Self {
        Self { data: self.data.iter().map(|&number| f(number)).collect(), ..self.clone() }
    }

    pub fn add(&self, other: &Self) -> Self {
        Self::from_fn(self.channels, self.rows, self.columns, |c, y, x| {
            self.get(c, y, x) + other.get(c, y, x)
        })
    }

    pub fn convolve(
        &self,
        shape: &[usize],
        weights: &[f32],
        bias: &[f32],
        [stride, padding, dilation]: [usize; 3],
    ) -> Self {
        let &[outputs, inputs, height, width] = shape else { panic!("shape {shape:?}") };
        assert_eq!(inputs, self.channels);
        let size =
            |size: usize, kernel: usize| (size + 2 * padding - (kernel - 1) * dilation - 1) / stride + 1;
        let (rows, columns) = (size(self.rows, height), size(self.columns, width));
        Self::from_fn(outputs, rows, columns, |o, y, x| {
            let mut sum = 0.0_f64;
            for c in 0..inputs {
                for j in 0..height {
                    for i in 0..width {
                        let row = (y * stride + j * dilation) as isize - padding as isize;
                        let column = (x * stride + i * dilation) as isize - padding as isize;
                        let weight = weights[((o * inputs + c) * height + j) * width + i];
                        sum += f64::from(weight) * f64::from(self.padded(c, row, column));
                    }
                }
            }
            (sum + f64::from(bias[o])) as f32
        })
    }

    pub fn normalize(&self, mean: &[f32], variance: &[f32], epsilon: f32) -> Self {
        Self::from_fn(self.channels, self.rows, self.columns, |c, y, x| {
            (self.get(c, y, x) - mean[c]) / (variance[c] + epsilon).sqrt()
        })
    }

    /// `factor` times as many rows and columns, linear between the centres of pixels.
    pub fn enlarge(&self, factor: usize) -> Self {
        let place = |i: usize, size: usize| {
            let place = ((i as f32 + 0.5) / factor as f32 - 0.5).clamp(0.0, (size - 1) as f32);
            let low = place as usize;
            (low, (low + 1).min(size - 1), place - low as f32)
        };
        Self::from_fn(self.channels, self.rows * factor, self.columns * factor, |c, y, x| {
            let (top, bottom, fy) = place(y, self.rows);
            let (left, right, fx) = place(x, self.columns);
            let row = |r: usize| self.get(c, r, left) * (1.0 - fx) + self.get(c, r, right) * fx;
            row(top) * (1.0 - fy) + row(bottom) * fy
        })
    }

    pub fn average(&self, side: usize) -> Self {
        Self::from_fn(self.channels, self.rows / side, self.columns / side, |c, y, x| {
            let sum: f32 =
                (0..side * side).map(|i| self.get(c, y * side + i / side, x * side + i % side)).sum();
            sum / (side * side) as f32
        })
    }

    /// The pixels of each square of each channel as channels.
    pub fn split(&self, side: usize) -> Self {
        let channels = self.channels * side * side;
        Self::from_fn(channels, self.rows / side, self.columns / side, |c, y, x| {
            let (channel, pixel) = (c / (side * side), c % (side * side));
            self.get(channel, y * side + pixel / side, x * side + pixel % side)
        })
    }
}
