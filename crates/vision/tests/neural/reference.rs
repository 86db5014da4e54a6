//! Layers of networks computed one number after the other, and XFeat put together from them as it was published:
//! nothing is folded, nothing is shared with the program.

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
        stride: usize,
        padding: usize,
    ) -> Self {
        let &[outputs, inputs, height, width] = shape else { panic!("shape {shape:?}") };
        assert_eq!(inputs, self.channels);
        let rows = (self.rows + 2 * padding - height) / stride + 1;
        let columns = (self.columns + 2 * padding - width) / stride + 1;
        Self::from_fn(outputs, rows, columns, |o, y, x| {
            let mut sum = 0.0_f64;
            for c in 0..inputs {
                for j in 0..height {
                    for i in 0..width {
                        let row = (y * stride + j) as isize - padding as isize;
                        let column = (x * stride + i) as isize - padding as isize;
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

    fn average(&self, side: usize) -> Self {
        Self::from_fn(self.channels, self.rows / side, self.columns / side, |c, y, x| {
            let sum: f32 =
                (0..side * side).map(|i| self.get(c, y * side + i / side, x * side + i % side)).sum();
            sum / (side * side) as f32
        })
    }

    /// Each square of pixels as channels.
    fn unfold(&self, side: usize) -> Self {
        Self::from_fn(side * side, self.rows / side, self.columns / side, |c, y, x| {
            self.get(0, y * side + c / side, x * side + c % side)
        })
    }
}

/// The names and shapes of XFeat's tensors.
pub fn xfeat_shapes() -> Vec<(String, Vec<usize>)> {
    let blocks: [(&str, &[[usize; 3]]); 8] = [
        ("block1", &[[4, 1, 3], [8, 4, 3], [8, 8, 3], [24, 8, 3]]),
        ("block2", &[[24, 24, 3], [24, 24, 3]]),
        ("block3", &[[64, 24, 3], [64, 64, 3], [64, 64, 1]]),
        ("block4", &[[64, 64, 3], [64, 64, 3], [64, 64, 3]]),
        ("block5", &[[128, 64, 3], [128, 128, 3], [128, 128, 3], [64, 128, 1]]),
        ("block_fusion", &[[64, 64, 3], [64, 64, 3]]),
        ("heatmap_head", &[[64, 64, 1], [64, 64, 1]]),
        ("keypoint_head", &[[64, 64, 1], [64, 64, 1], [64, 64, 1]]),
    ];
    let mut shapes = vec![("skip1.1.weight".into(), vec![24, 1, 1, 1]), ("skip1.1.bias".into(), vec![24])];
    for (block, layers) in blocks {
        for (index, &[outputs, inputs, side]) in layers.iter().enumerate() {
            let layer = format!("{block}.{index}.layer");
            shapes.push((format!("{layer}.0.weight"), vec![outputs, inputs, side, side]));
            shapes.push((format!("{layer}.1.running_mean"), vec![outputs]));
            shapes.push((format!("{layer}.1.running_var"), vec![outputs]));
        }
    }
    for (name, outputs) in [("block_fusion.2", 64), ("heatmap_head.2", 1), ("keypoint_head.3", 65)] {
        shapes.push((format!("{name}.weight"), vec![outputs, 64, 1, 1]));
        shapes.push((format!("{name}.bias"), vec![outputs]));
    }
    shapes
}

/// Descriptors, keypoint logits and reliability.
pub fn xfeat(tensors: &Tensors, image: &Map) -> [Map; 3] {
    let layer = |map: &Map, name: &str, stride: usize| {
        let (shape, weights) = &tensors[&format!("{name}.layer.0.weight")];
        let sum = map.convolve(shape, weights, &vec![0.0; shape[0]], stride, shape[3] / 2);
        let mean = &tensors[&format!("{name}.layer.1.running_mean")].1;
        let variance = &tensors[&format!("{name}.layer.1.running_var")].1;
        sum.normalize(mean, variance, 1e-5).map(|number| number.max(0.0))
    };
    let block = |map: &Map, name: &str, strides: &[usize]| {
        strides
            .iter()
            .enumerate()
            .fold(map.clone(), |map, (i, &stride)| layer(&map, &format!("{name}.{i}"), stride))
    };
    let plain = |map: &Map, name: &str| {
        let (shape, weights) = &tensors[&format!("{name}.weight")];
        map.convolve(shape, weights, &tensors[&format!("{name}.bias")].1, 1, 0)
    };
    let x1 = block(image, "block1", &[1, 2, 1, 2]);
    let x2 = block(&x1.add(&plain(&image.average(4), "skip1.1")), "block2", &[1, 1]);
    let x3 = block(&x2, "block3", &[2, 1, 1]);
    let x4 = block(&x3, "block4", &[2, 1, 1]);
    let x5 = block(&x4, "block5", &[2, 1, 1, 1]);
    let pyramid = x3.add(&x4.enlarge(2)).add(&x5.enlarge(4));
    let descriptors = plain(&block(&pyramid, "block_fusion", &[1, 1]), "block_fusion.2");
    let reliability = plain(&block(&descriptors, "heatmap_head", &[1, 1]), "heatmap_head.2");
    let keypoints = plain(&block(&image.unfold(8), "keypoint_head", &[1, 1, 1]), "keypoint_head.3");
    [descriptors, keypoints, reliability.map(|number| 1.0 / (1.0 + (-number).exp()))]
}
