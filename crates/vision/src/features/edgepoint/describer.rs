//! Descriptors of EdgePoint2 at keypoints.
//!
//! ```text
//! h = 1x1 convolution of [q, enlarged x2, enlarged x3]                   H/4
//! g = ReLU(normalized 3x3 convolution of h in groups of 16 channels)     H/4
//! d = 1x1 convolution of g, bilinear at the keypoint, of length 1
//! ```
//! Only the cells that a keypoint needs are computed. The first layer is linear, so that it comes before the enlargement where the maps are small; the
//! last one is linear, too, and comes after the interpolation.

use super::network::Maps;
use crate::features::layers::Map;
use crate::features::layers::product::Matrix;
use crate::features::layers::reader::Reader;
use crate::features::layers::resampling::neighbours;
use crate::features::state_dict::{StateDict, StateDictError};
use crate::matching::descriptors::normalize;
use pulp::{Arch, NullaryFnOnce};

/// Channels of a group.
const GROUP: usize = 16;
/// Side of a cell, pixels.
pub(super) const CELL: usize = 4;
/// Side of the square of cells that a keypoint needs.
const WINDOW: usize = 4;

/// The layers, and memory that is reused from image to image.
pub(super) struct Describer {
    /// Of q, x2 and x3.
    mix: [Matrix; 3],
    groups: Vec<Matrix>,
    last: Matrix,
    /// h of the cells, with a border of zeros.
    mixed: Vec<f32>,
    /// Whether h of a cell is there.
    is_mixed: Vec<bool>,
}

impl Describer {
    /// # Errors
    /// [`StateDictError`]: a tensor is missing, has another shape than the others suggest, or is not finite.
    pub fn new(weights: &StateDict) -> Result<Self, StateDictError> {
        let reader = Reader(weights);
        let channels = |name: &str| Ok::<_, StateDictError>(weights.shape::<4>(name)?[0]);
        let parts = [
            channels("block1.1.layer.0.weight")?,
            channels("block2.layer.0.weight")?,
            channels("block3.layer.0.weight")?,
        ];
        let sum = parts.iter().sum::<usize>();
        let dimension = channels("desc_head.2.weight")?;
        let blocks = [("desc_head.0.weight", sum), ("desc_head.2.weight", dimension)];
        for (name, size) in blocks {
            if size == 0 || !size.is_multiple_of(GROUP) {
                let needed = vec![size.next_multiple_of(GROUP).max(GROUP), sum, 1, 1];
                return Err(StateDictError::Shape {
                    name: name.to_owned(),
                    found: vec![size, sum, 1, 1],
                    needed,
                });
            }
        }
        let mix = reader.convolution("desc_head.0", [sum, sum, 1, 1])?;
        let mut first = 0;
        let mix = parts.map(|count| {
            let rows =
                mix.weights.chunks_exact(sum).flat_map(|row| row[first..first + count].iter().copied());
            let bias = if first == 0 { mix.bias.clone() } else { vec![0.0; sum] };
            let part = Matrix::new(&rows.collect::<Vec<f32>>(), &bias);
            first += count;
            part
        });
        let grouped = reader.unbiased("desc_head.1.layer.0", [sum, GROUP, 3, 3])?;
        let grouped = reader.scaled(grouped, "desc_head.1.layer.1")?;
        // The inputs in the order of the cells in memory: by rows, columns, channels.
        let by_cell = |kernel: &[f32]| -> Vec<f32> {
            (0..9 * GROUP).map(|at| kernel[at % GROUP * 9 + at / GROUP]).collect()
        };
        let groups = grouped.weights.chunks_exact(GROUP * GROUP * 9).zip(grouped.bias.chunks_exact(GROUP));
        let groups = groups.map(|(kernels, bias)| {
            let rows: Vec<f32> = kernels.chunks_exact(GROUP * 9).flat_map(by_cell).collect();
            Matrix::new(&rows, bias)
        });
        let groups = groups.collect();
        let last = reader.convolution("desc_head.2", [dimension, sum, 1, 1])?;
        let last = Matrix::new(&last.weights, &last.bias);
        Ok(Self { mix, groups, last, mixed: Vec::new(), is_mixed: Vec::new() })
    }

    /// Numbers of a descriptor.
    pub fn dimension(&self) -> usize {
        self.last.outputs()
    }

    /// Descriptors of length 1 of pixels, one after the other.
    ///
    /// # Arguments
    /// * `pixels`: at least 2.5 pixels from each side of the image.
    pub fn describe(&mut self, maps: &Maps, pixels: &[[f32; 2]]) -> Vec<f32> {
        let width = maps.quarter.columns() + 2;
        self.mix_cells(maps, pixels);
        let sum = GROUP * self.groups.len();
        let mut interpolated = Vec::with_capacity(pixels.len() * sum);
        let mut inputs = vec![0.0; 4 * 9 * GROUP];
        let mut outputs = Vec::new();
        for &pixel in pixels {
            let ([x, y], weights) = cell_of(pixel);
            for (group, matrix) in self.groups.iter().enumerate() {
                for (at, input) in inputs.chunks_exact_mut(GROUP).enumerate() {
                    let (cell, dx, dy) = (at / 9, at % 3, at / 3 % 3);
                    // The border is one cell wide: the cell before x is at x.
                    let from = (y + cell / 2 + dy) * width + x + cell % 2 + dx;
                    input.copy_from_slice(&self.mixed[from * sum + group * GROUP..][..GROUP]);
                }
                matrix.multiply(&inputs, &mut outputs);
                let start = interpolated.len();
                interpolated.resize(start + GROUP, 0.0);
                for (outputs, weight) in outputs.as_chunks::<GROUP>().0.iter().zip(weights) {
                    for (number, output) in interpolated[start..].iter_mut().zip(outputs) {
                        *number += weight * output.max(0.0);
                    }
                }
            }
        }
        let mut descriptors = Vec::new();
        self.last.multiply(&interpolated, &mut descriptors);
        for descriptor in descriptors.chunks_exact_mut(self.dimension()) {
            normalize(descriptor);
        }
        descriptors
    }

    /// h of the cells that the pixels need.
    fn mix_cells(&mut self, maps: &Maps, pixels: &[[f32; 2]]) {
        let (columns, rows) = (maps.quarter.columns(), maps.quarter.rows());
        let (width, sum) = (columns + 2, GROUP * self.groups.len());
        if self.is_mixed.len() != width * (rows + 2) || self.mixed.len() != self.is_mixed.len() * sum {
            self.mixed = vec![0.0; width * (rows + 2) * sum];
        }
        self.is_mixed.clear();
        self.is_mixed.resize(width * (rows + 2), false);
        let mut cells = Vec::new();
        for &pixel in pixels {
            let ([x, y], _) = cell_of(pixel);
            for at in 0..WINDOW * WINDOW {
                let (x, y) = (x + at % WINDOW, y + at / WINDOW);
                let is_inside = (1..=columns).contains(&x) && (1..=rows).contains(&y);
                if is_inside && !std::mem::replace(&mut self.is_mixed[y * width + x], true) {
                    cells.push([x - 1, y - 1]);
                }
            }
        }
        let inputs: Vec<f32> = cells
            .iter()
            .flat_map(|&[x, y]| (0..maps.quarter.channels()).map(move |c| maps.quarter.row(c, y)[x]))
            .collect();
        let mut own = Vec::new();
        self.mix[0].multiply(&inputs, &mut own);
        let [_, x2, x3] = &maps.features;
        let coarse = [(x2, &self.mix[1], 2), (x3, &self.mix[2], 8)]
            .map(|(map, matrix, factor)| Coarse::new(map, matrix, factor));
        let mixed = &mut self.mixed;
        Arch::new().dispatch(Mix { cells: &cells, own: &own, coarse: &coarse, sum, width, mixed });
    }
}

/// The top left of the four cells around a pixel, and their weights.
fn cell_of([u, v]: [f32; 2]) -> ([usize; 2], [f32; 4]) {
    let place = |coordinate: f32| (coordinate + 0.5) / CELL as f32 - 0.5;
    let (x, y) = (place(u), place(v));
    let (fx, fy) = (x - x.floor(), y - y.floor());
    let weights = [(1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy];
    ([x as usize, y as usize], weights)
}

/// The part of h that comes from a coarser map, before its enlargement.
struct Coarse {
    columns: usize,
    rows: usize,
    factor: usize,
    data: Vec<f32>,
}

impl Coarse {
    fn new(map: &Map, matrix: &Matrix, factor: usize) -> Self {
        let (columns, rows, channels) = (map.columns(), map.rows(), map.channels());
        let mut cells = vec![0.0; columns * rows * channels];
        for y in 0..rows {
            for channel in 0..channels {
                let row = cells[y * columns * channels..].chunks_exact_mut(channels);
                for (cell, &number) in row.zip(map.row(channel, y)) {
                    cell[channel] = number;
                }
            }
        }
        let mut data = Vec::new();
        matrix.multiply(&cells, &mut data);
        Self { columns, rows, factor, data }
    }

    fn cell(&self, x: usize, y: usize, sum: usize) -> &[f32] {
        &self.data[(y * self.columns + x) * sum..][..sum]
    }
}

struct Mix<'a> {
    cells: &'a [[usize; 2]],
    /// The part of h that comes from q.
    own: &'a [f32],
    coarse: &'a [Coarse; 2],
    sum: usize,
    width: usize,
    mixed: &'a mut [f32],
}

impl NullaryFnOnce for Mix<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        for (&[x, y], own) in self.cells.iter().zip(self.own.chunks_exact(self.sum)) {
            let mixed = &mut self.mixed[((y + 1) * self.width + x + 1) * self.sum..][..self.sum];
            mixed.copy_from_slice(own);
            for coarse in self.coarse {
                let ([left, right], fx) = neighbours(x, coarse.factor, coarse.columns);
                let ([top, bottom], fy) = neighbours(y, coarse.factor, coarse.rows);
                let cell = |x, y| coarse.cell(x, y, self.sum);
                let (a, b, c, d) =
                    (cell(left, top), cell(right, top), cell(left, bottom), cell(right, bottom));
                for (number, (((a, b), c), d)) in mixed.iter_mut().zip(a.iter().zip(b).zip(c).zip(d)) {
                    let (above, below) = (a + fx * (b - a), c + fx * (d - c));
                    *number += above + fy * (below - above);
                }
            }
        }
    }
}
