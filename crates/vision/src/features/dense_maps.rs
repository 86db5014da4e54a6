//! Dense maps over an image: sub-pixel peaks, and interpolation.

use super::layers::Map;
use crate::matching::descriptors::normalize;
use std::cmp::Ordering;

/// Parameter of bicubic interpolation (slope at the first neighbour), as in the training of XFeat.
const CUBIC: f32 = -0.75;

/// One number per cell.
pub(super) struct Heatmap {
    pub width: usize,
    pub height: usize,
    pub data: Vec<f32>,
}

/// A local maximum.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Peak {
    pub x: usize,
    pub y: usize,
    pub heat: f32,
}

impl Heatmap {
    /// One channel of a map.
    pub fn of_channel(map: &Map, channel: usize) -> Self {
        let data = (0..map.rows()).flat_map(|y| map.row(channel, y)).copied().collect();
        Self { width: map.columns(), height: map.rows(), data }
    }

    fn get(&self, x: usize, y: usize) -> f32 {
        self.data[y * self.width + x]
    }

    /// Every cell above `threshold` that is the maximum of the square of `radius` cells around it. Of equal neighbours the
    /// first in row-major order is taken.
    pub fn peaks(&self, radius: usize, threshold: f32) -> Vec<Peak> {
        let mut peaks = Vec::new();
        for y in 0..self.height {
            let row = &self.data[y * self.width..(y + 1) * self.width];
            for (x, &heat) in row.iter().enumerate() {
                if heat > threshold && self.is_greatest(x, y, radius) {
                    peaks.push(Peak { x, y, heat });
                }
            }
        }
        peaks
    }

    fn is_greatest(&self, x: usize, y: usize, radius: usize) -> bool {
        let own = self.get(x, y);
        let columns = x.saturating_sub(radius)..=(x + radius).min(self.width - 1);
        (y.saturating_sub(radius)..=(y + radius).min(self.height - 1)).all(|row| {
            columns.clone().all(|column| {
                let other = self.get(column, row);
                match own.total_cmp(&other) {
                    Ordering::Greater => true,
                    Ordering::Equal => (row, column) >= (y, x),
                    Ordering::Less => false,
                }
            })
        })
    }

    /// Sub-cell position of a peak: vertex of the parabola through the logarithms of the peak and its two neighbours, along
    /// each axis. A peak at the border is not refined.
    pub fn refine(&self, peak: Peak) -> [f32; 2] {
        let (x, y) = (peak.x, peak.y);
        let inside = x > 0 && y > 0 && x + 1 < self.width && y + 1 < self.height;
        if !inside {
            return [x as f32, y as f32];
        }
        let log = |x, y| self.get(x, y).max(f32::MIN_POSITIVE).ln();
        let top = log(x, y);
        let dx = vertex(log(x - 1, y), top, log(x + 1, y));
        let dy = vertex(log(x, y - 1), top, log(x, y + 1));
        [x as f32 + dx, y as f32 + dy]
    }

    /// Bilinear interpolation; the border is replicated.
    pub fn bilinear(&self, x: f32, y: f32) -> f32 {
        let x = x.clamp(0.0, (self.width - 1) as f32);
        let y = y.clamp(0.0, (self.height - 1) as f32);
        let (left, top) = (x as usize, y as usize);
        let (right, bottom) = ((left + 1).min(self.width - 1), (top + 1).min(self.height - 1));
        let (fx, fy) = (x - left as f32, y - top as f32);
        let above = self.get(left, top) * (1.0 - fx) + self.get(right, top) * fx;
        let below = self.get(left, bottom) * (1.0 - fx) + self.get(right, bottom) * fx;
        above * (1.0 - fy) + below * fy
    }
}

/// Vertex of the parabola through three values at -1, 0 and 1, within half a cell.
fn vertex(before: f32, top: f32, after: f32) -> f32 {
    let curvature = before - 2.0 * top + after;
    if curvature < 0.0 { (0.5 * (before - after) / curvature).clamp(-0.5, 0.5) } else { 0.0 }
}

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
#[allow(clippy::float_cmp)]
mod tests {
    use super::*;

    fn heat(width: usize, height: usize, value: impl Fn(f32, f32) -> f32) -> Heatmap {
        let data = (0..width * height).map(|i| value((i % width) as f32, (i / width) as f32)).collect();
        Heatmap { width, height, data }
    }

    #[test]
    fn the_peak_of_a_gaussian_is_found_to_a_thousandth_of_a_cell() {
        for (cx, cy) in [(5.0, 4.0), (5.3, 4.2), (4.6, 4.49)] {
            let bell = heat(12, 9, |x, y| (-0.4 * ((x - cx).powi(2) + (y - cy).powi(2))).exp());
            let peaks = bell.peaks(2, 0.05);
            assert_eq!(peaks.len(), 1);
            let [x, y] = bell.refine(peaks[0]);
            assert!((x - cx).abs() < 1e-3 && (y - cy).abs() < 1e-3, "{x} {y} is not {cx} {cy}");
        }
    }

    #[test]
    fn a_plateau_has_one_peak_and_peaks_keep_their_distance() {
        let plateau = heat(9, 9, |x, y| if (3.0..=4.0).contains(&x) && y == 4.0 { 1.0 } else { 0.0 });
        assert_eq!(plateau.peaks(2, 0.05), vec![Peak { x: 3, y: 4, heat: 1.0 }]);
        let noise = heat(40, 30, |x, y| ((x * 12.9 + y * 78.2).sin() * 43758.5).fract().abs());
        let peaks = noise.peaks(2, 0.05);
        for (i, a) in peaks.iter().enumerate() {
            for b in &peaks[..i] {
                assert!(a.x.abs_diff(b.x) > 2 || a.y.abs_diff(b.y) > 2, "{a:?} {b:?}");
            }
        }
        assert!(peaks.len() > 20);
    }

    #[test]
    fn interpolation_agrees_with_the_cells_and_is_linear_between() {
        let ramp = heat(8, 6, |x, y| 0.1 * x + 0.2 * y);
        assert!((ramp.bilinear(2.5, 3.25) - 0.9).abs() < 1e-6);
        assert!((ramp.bilinear(-3.0, 99.0) - 1.0).abs() < 1e-6);
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
