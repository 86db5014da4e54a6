//! The descriptors of cells, interpolated.

use crate::features::layers::Map;
use crate::matching::descriptors::normalize;

/// Parameter of bicubic interpolation (slope at the first neighbour), as in the training of XFeat.
const CUBIC: f32 = -0.75;

/// One unit vector per cell, row-major.
pub(super) struct Descriptors {
    width: usize,
    height: usize,
    dimension: usize,
    data: Vec<f32>,
}

impl Descriptors {
    /// The channels of each cell of a map, normalized.
    pub fn of_map(map: &Map) -> Self {
        let (width, height, dimension) = (map.columns(), map.rows(), map.channels());
        let mut data = vec![0.0; height * width * dimension];
        for (y, row) in data.chunks_exact_mut(width * dimension).enumerate() {
            for channel in 0..dimension {
                for (vector, &value) in row.chunks_exact_mut(dimension).zip(map.row(channel, y)) {
                    vector[channel] = value;
                }
            }
        }
        for vector in data.chunks_exact_mut(dimension) {
            normalize(vector);
        }
        Self { width, height, dimension, data }
    }

    /// Writes the unit vector by bicubic interpolation to `vector`; the border is replicated.
    pub fn bicubic(&self, x: f32, y: f32, vector: &mut [f32]) {
        let (left, top) = (x.floor(), y.floor());
        let (weights_x, weights_y) = (cubic_weights(x - left), cubic_weights(y - top));
        let clamp = |cell: f32, size: usize| cell.clamp(0.0, (size - 1) as f32) as usize;
        vector.fill(0.0);
        for (row, weight_y) in weights_y.iter().enumerate() {
            let cell_y = clamp(top + row as f32 - 1.0, self.height);
            for (column, weight_x) in weights_x.iter().enumerate() {
                let cell_x = clamp(left + column as f32 - 1.0, self.width);
                let weight = weight_x * weight_y;
                for (sum, number) in vector.iter_mut().zip(self.get(cell_x, cell_y)) {
                    *sum += weight * number;
                }
            }
        }
        normalize(vector);
    }

    fn get(&self, x: usize, y: usize) -> &[f32] {
        let start = (y * self.width + x) * self.dimension;
        &self.data[start..start + self.dimension]
    }
}

/// Weights of the cells at -1, 0, 1 and 2 for a point at `t` in [0, 1].
///
/// Source: Keys, "Cubic convolution interpolation for digital image processing", 1981.
fn cubic_weights(t: f32) -> [f32; 4] {
    let near = |d: f32| ((CUBIC + 2.0) * d - (CUBIC + 3.0)) * d * d + 1.0;
    let far = |d: f32| ((CUBIC * d - 5.0 * CUBIC) * d + 8.0 * CUBIC) * d - 4.0 * CUBIC;
    [far(1.0 + t), near(t), near(1.0 - t), far(2.0 - t)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn interpolation_agrees_with_the_cells() {
        for t in [0.0, 0.2, 0.9] {
            assert!((cubic_weights(t).iter().sum::<f32>() - 1.0).abs() < 1e-6);
        }
        let mut map = Map::zeros(3, 5, 6);
        for (at, number) in (0..6 * 5 * 3).map(|i| ((i * 37 % 17) as f32) - 8.0).enumerate() {
            map.row_mut(at / 30, at / 6 % 5)[at % 6] = number;
        }
        let mut vector = [0.0; 3];
        Descriptors::of_map(&map).bicubic(4.0, 2.0, &mut vector);
        let mut expected = [0, 1, 2].map(|channel| map.row(channel, 2)[4]);
        normalize(&mut expected);
        assert!(vector.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-5));
    }
}
