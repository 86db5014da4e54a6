//! Compression of the 128 numbers of a histogram to 64 signed bytes.
//!
//! The histogram is transformed by a cosine transform over rows and columns and a Fourier series over directions. Its
//! energy is concentrated in low frequencies: the 64 retained coefficients hold 94 % of the variance (96 % for the
//! optimum, a principal component analysis). Each is centred by its mean, so that angles between descriptors use the whole
//! range, and divided by the square root of its standard deviation, halfway to whitening.

use super::histogram::{CELLS, DIRECTIONS, NUMBERS};
use std::f32::consts::{PI, TAU};

/// Bytes per descriptor.
pub(super) const WIDTH: usize = 64;
/// Root mean square of the bytes: three standard deviations fit.
const BYTE_DEVIATION: f32 = 127.0 / 3.0;

/// A retained coefficient: its frequencies over rows, columns and directions, its mean and standard deviation.
type Coefficient = (u8, u8, u8, f32, f32);

/// The 64 coefficients of largest variance, of 20,000 histograms from 40 images of EuRoC's `MH_01_easy`
/// (`mh_01_handheld_16s`, a machine hall).
///
/// Frequencies over directions are 1, cos, sin, cos 2, sin 2, cos 3, sin 3, cos 4.
#[rustfmt::skip]
const KEPT: [Coefficient; WIDTH] = [
    (0, 0, 1, 0.187, 0.183), (0, 1, 1, 0.008, 0.160), (0, 0, 3, 0.176, 0.148), (0, 0, 2, -0.004, 0.132),
    (1, 0, 2, 0.004, 0.131), (0, 2, 1, -0.127, 0.118), (0, 3, 1, 0.000, 0.112), (0, 0, 4, 0.000, 0.101),
    (0, 1, 3, 0.003, 0.097), (0, 1, 2, 0.001, 0.095), (1, 1, 2, -0.040, 0.086), (0, 1, 0, -0.003, 0.085),
    (2, 0, 2, -0.002, 0.085), (0, 0, 0, 0.743, 0.084), (1, 0, 3, -0.001, 0.081), (0, 1, 4, -0.001, 0.077),
    (1, 0, 4, 0.004, 0.074), (1, 1, 1, 0.001, 0.072), (2, 1, 2, -0.001, 0.072), (1, 0, 1, 0.000, 0.071),
    (0, 0, 5, 0.052, 0.068), (1, 2, 1, -0.002, 0.067), (0, 2, 3, -0.050, 0.063), (3, 0, 2, 0.004, 0.063),
    (1, 2, 2, -0.001, 0.062), (1, 1, 4, -0.009, 0.055), (0, 0, 7, 0.044, 0.054), (1, 1, 3, 0.001, 0.054),
    (1, 0, 0, 0.001, 0.052), (0, 2, 2, 0.001, 0.052), (2, 3, 1, -0.002, 0.050), (0, 1, 5, 0.003, 0.050),
    (0, 2, 0, -0.076, 0.048), (3, 2, 2, -0.002, 0.048), (2, 1, 1, -0.001, 0.047), (3, 1, 2, 0.010, 0.046),
    (2, 2, 2, 0.000, 0.045), (2, 0, 3, -0.031, 0.045), (1, 3, 1, 0.001, 0.045), (0, 2, 4, 0.000, 0.045),
    (2, 2, 1, 0.013, 0.043), (2, 0, 4, -0.002, 0.043), (0, 2, 5, -0.030, 0.043), (1, 2, 4, -0.001, 0.042),
    (1, 1, 0, -0.001, 0.042), (2, 0, 1, -0.013, 0.042), (0, 0, 6, -0.001, 0.041), (1, 2, 3, 0.001, 0.040),
    (2, 0, 0, -0.052, 0.039), (1, 0, 6, 0.004, 0.039), (2, 1, 3, 0.000, 0.038), (0, 1, 6, 0.000, 0.037),
    (1, 0, 5, 0.000, 0.036), (2, 1, 4, 0.000, 0.035), (0, 3, 3, 0.001, 0.034), (3, 0, 4, 0.001, 0.033),
    (0, 1, 7, 0.004, 0.032), (0, 3, 2, -0.001, 0.031), (1, 1, 6, -0.003, 0.030), (1, 3, 2, 0.008, 0.030),
    (0, 3, 4, 0.000, 0.029), (2, 1, 0, 0.001, 0.028), (1, 1, 5, 0.000, 0.028), (2, 2, 4, 0.000, 0.028)
];

/// The weighted projection.
pub(super) struct Compressor {
    /// Weights of the histogram for each byte.
    rows: Vec<[f32; NUMBERS]>,
    /// Value of the mean histogram for each byte.
    means: [f32; WIDTH],
}

impl Compressor {
    pub(super) fn new() -> Self {
        let energy = KEPT.iter().map(|kept| kept.4).sum::<f32>();
        let gain = BYTE_DEVIATION * (WIDTH as f32 / energy).sqrt();
        let mut means = [0.0; WIDTH];
        let rows = KEPT.iter().zip(&mut means).map(|(&(u, v, k, mean, deviation), of_mean)| {
            let weight = gain / deviation.sqrt();
            *of_mean = weight * mean;
            std::array::from_fn(|number| {
                let (cell, direction) = (number / DIRECTIONS, number % DIRECTIONS);
                let over_cells = cosine(u, cell / CELLS) * cosine(v, cell % CELLS);
                weight * over_cells * harmonic(k, direction)
            })
        });
        let rows = rows.collect();
        Self { rows, means }
    }

    /// The signed bytes of a histogram.
    pub(super) fn compress(&self, histogram: &[f32; NUMBERS]) -> [u8; WIDTH] {
        std::array::from_fn(|byte| {
            let number = dot(&self.rows[byte], histogram) - self.means[byte];
            (number.round().clamp(-127.0, 127.0) as i8).cast_unsigned()
        })
    }
}

/// The cosine transform: orthonormal over the cells of a row or column.
fn cosine(frequency: u8, cell: usize) -> f32 {
    let norm = if frequency == 0 { 1.0 } else { 2.0_f32 };
    (norm / CELLS as f32).sqrt() * (PI * f32::from(frequency) * (cell as f32 + 0.5) / CELLS as f32).cos()
}

/// The Fourier series: orthonormal over the directions.
fn harmonic(frequency: u8, direction: usize) -> f32 {
    let turns = f32::from(frequency.div_ceil(2)) * direction as f32 / DIRECTIONS as f32;
    let alone = frequency == 0 || usize::from(frequency) == DIRECTIONS - 1;
    let norm = if alone { 1.0 } else { 2.0_f32 };
    let wave = if frequency % 2 == 1 { (TAU * turns).cos() } else { (TAU * turns).sin() };
    (norm / DIRECTIONS as f32).sqrt() * if frequency == 0 { 1.0 } else { wave }
}

/// Scalar product in eight lanes, which the compiler vectorizes.
fn dot(a: &[f32; NUMBERS], b: &[f32; NUMBERS]) -> f32 {
    let mut sums = [0.0; 8];
    for (x, y) in a.as_chunks::<8>().0.iter().zip(b.as_chunks::<8>().0) {
        for lane in 0..8 {
            sums[lane] += x[lane] * y[lane];
        }
    }
    sums.iter().sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_kept_coefficients_are_orthogonal_once_the_weights_are_taken_off() {
        let compressor = Compressor::new();
        let weight = |byte: usize| dot(&compressor.rows[byte], &compressor.rows[byte]).sqrt();
        for (a, row) in compressor.rows.iter().enumerate() {
            for (b, other) in compressor.rows.iter().enumerate().take(a) {
                let cosine = dot(row, other) / (weight(a) * weight(b));
                assert!(cosine.abs() < 1e-5, "bytes {a} and {b}: {cosine}");
            }
        }
    }

    #[test]
    fn distances_of_histograms_survive() {
        // Half of the numbers swapped in pairs moves a histogram; less of it moves the bytes less.
        let even: [f32; NUMBERS] = std::array::from_fn(|k| ((k * 37 % 128) as f32 / 8128.0).sqrt());
        let moved = |count: usize| {
            let mut other = even;
            other.chunks_exact_mut(2).take(count).for_each(|pair| pair.swap(0, 1));
            other
        };
        let compressor = Compressor::new();
        let distance = |count| {
            let (a, b) = (compressor.compress(&even), compressor.compress(&moved(count)));
            crate::matching::distance(crate::matching::Metric::CosineInt8, &a, &b)
        };
        let distances = [0, 4, 16, 64].map(distance);
        assert!(distances[0] == 0.0 && distances.is_sorted_by(|a, b| a < b), "{distances:?}");
    }
}
