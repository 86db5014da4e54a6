//! Numbers of all pixels, their local maxima and interpolation.

use super::layers::{Layer, Map};
use pulp::{Arch, NullaryFnOnce};

/// One number per cell.
#[derive(Default)]
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

    /// Takes over the four phases of a map of half the size.
    pub fn fill(&mut self, phases: &Map) {
        (self.width, self.height) = (2 * phases.columns(), 2 * phases.rows());
        self.data.resize(self.width * self.height, 0.0);
        Arch::new().dispatch(Fill { heatmap: self, phases });
    }

    /// A row of cells.
    pub fn row(&self, y: usize) -> &[f32] {
        &self.data[y * self.width..(y + 1) * self.width]
    }

    /// Every cell above `threshold` that is the maximum of the square of `RADIUS` cells around it, row by row. Of equal neighbours the
    /// first is taken.
    pub fn peaks<const RADIUS: usize>(&self, threshold: f32) -> Vec<Peak> {
        Arch::new().dispatch(Find::<RADIUS> { heatmap: self, threshold })
    }

    /// Whether no cell before this one in its square is as great.
    fn is_first(&self, x: usize, y: usize, radius: usize) -> bool {
        let own = self.row(y)[x];
        let columns = x.saturating_sub(radius)..(x + radius + 1).min(self.width);
        let mut above = y.saturating_sub(radius)..y;
        above.all(|row| self.row(row)[columns.clone()].iter().all(|&other| other < own))
            && self.row(y)[columns.start..x].iter().all(|&other| other < own)
    }

    /// Sub-cell position of a peak: vertex of the parabola through it and its two neighbours, along each axis. A peak at the border is not
    /// refined.
    ///
    /// # Arguments
    /// * `scale`: applied to the numbers first.
    pub fn refine(&self, peak: Peak, scale: impl Fn(f32) -> f32) -> [f32; 2] {
        let (x, y) = (peak.x, peak.y);
        let inside = x > 0 && y > 0 && x + 1 < self.width && y + 1 < self.height;
        if !inside {
            return [x as f32, y as f32];
        }
        let at = |x: usize, y: usize| scale(self.row(y)[x]);
        let top = at(x, y);
        let dx = vertex(at(x - 1, y), top, at(x + 1, y));
        let dy = vertex(at(x, y - 1), top, at(x, y + 1));
        [x as f32 + dx, y as f32 + dy]
    }

    /// Bilinear interpolation; the border is replicated.
    pub fn bilinear(&self, x: f32, y: f32) -> f32 {
        let x = x.clamp(0.0, (self.width - 1) as f32);
        let y = y.clamp(0.0, (self.height - 1) as f32);
        let (left, top) = (x as usize, y as usize);
        let (right, bottom) = ((left + 1).min(self.width - 1), (top + 1).min(self.height - 1));
        let (fx, fy) = (x - left as f32, y - top as f32);
        let above = self.row(top)[left] * (1.0 - fx) + self.row(top)[right] * fx;
        let below = self.row(bottom)[left] * (1.0 - fx) + self.row(bottom)[right] * fx;
        above * (1.0 - fy) + below * fy
    }
}

/// The logarithm of a probability, in which a peak of a Gaussian is a parabola.
pub(super) fn log(heat: f32) -> f32 {
    heat.max(f32::MIN_POSITIVE).ln()
}

struct Fill<'a> {
    heatmap: &'a mut Heatmap,
    phases: &'a Map,
}

impl NullaryFnOnce for Fill<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { heatmap, phases } = self;
        for (y, row) in heatmap.data.chunks_exact_mut(heatmap.width).enumerate() {
            let of = |x| phases.row(Layer::phase(2, 0, [x, y % 2]), y / 2);
            for ((pair, &left), &right) in row.as_chunks_mut::<2>().0.iter_mut().zip(of(0)).zip(of(1)) {
                *pair = [left, right];
            }
        }
    }
}

struct Find<'a, const RADIUS: usize> {
    heatmap: &'a Heatmap,
    threshold: f32,
}

impl<const RADIUS: usize> NullaryFnOnce for Find<'_, RADIUS> {
    type Output = Vec<Peak>;

    #[inline(always)]
    fn call(self) -> Vec<Peak> {
        let Self { heatmap, threshold } = self;
        let (width, height, side) = (heatmap.width, heatmap.height, 2 * RADIUS + 1);
        let mut peaks = Vec::new();
        // The greatest of each cell and its neighbours in the row, of as many rows as the square has.
        let mut ring = vec![f32::NEG_INFINITY; side * width];
        let mut greatest = vec![0.0; width];
        let mut is_peak = vec![false; width];
        for below in 0..height + RADIUS {
            let slot = &mut ring[below % side * width..][..width];
            if below < height {
                along_row::<RADIUS>(heatmap.row(below), slot);
            } else {
                slot.fill(f32::NEG_INFINITY);
            }
            let Some(y) = below.checked_sub(RADIUS) else { continue };
            greatest.copy_from_slice(&ring[..width]);
            for row in ring.chunks_exact(width).skip(1) {
                for (greatest, &number) in greatest.iter_mut().zip(row) {
                    *greatest = larger(*greatest, number);
                }
            }
            let row = heatmap.row(y);
            for ((is_peak, &heat), &greatest) in is_peak.iter_mut().zip(row).zip(&greatest) {
                *is_peak = heat >= greatest;
            }
            for x in (0..width).filter(|&x| is_peak[x]) {
                if row[x] > threshold && heatmap.is_first(x, y, RADIUS) {
                    peaks.push(Peak { x, y, heat: row[x] });
                }
            }
        }
        peaks
    }
}

/// The greatest of each number and its `RADIUS` neighbours on either side.
#[inline(always)]
fn along_row<const RADIUS: usize>(row: &[f32], greatest: &mut [f32]) {
    greatest.copy_from_slice(row);
    for shift in 1..=RADIUS.min(row.len()) {
        let count = row.len() - shift;
        for (greatest, &number) in greatest[..count].iter_mut().zip(&row[shift..]) {
            *greatest = larger(*greatest, number);
        }
        for (greatest, &number) in greatest[shift..].iter_mut().zip(&row[..count]) {
            *greatest = larger(*greatest, number);
        }
    }
}

/// The larger of two numbers, neither of which is NaN: one instruction.
#[inline(always)]
fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// Vertex of the parabola through three values at -1, 0 and 1, within half a cell.
fn vertex(before: f32, top: f32, after: f32) -> f32 {
    let curvature = before - 2.0 * top + after;
    let vertex = 0.5 * (before - after) / curvature;
    // Of infinite values it is no number.
    if curvature < 0.0 && !vertex.is_nan() { vertex.clamp(-0.5, 0.5) } else { 0.0 }
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
            let peaks = bell.peaks::<2>(0.05);
            assert_eq!(peaks.len(), 1);
            let [x, y] = bell.refine(peaks[0], log);
            assert!((x - cx).abs() < 1e-3 && (y - cy).abs() < 1e-3, "{x} {y} is not {cx} {cy}");
        }
    }

    #[test]
    fn a_plateau_has_one_peak_and_peaks_keep_their_distance() {
        let plateau = heat(9, 9, |x, y| if (3.0..=4.0).contains(&x) && y == 4.0 { 1.0 } else { 0.0 });
        assert_eq!(plateau.peaks::<2>(0.05), vec![Peak { x: 3, y: 4, heat: 1.0 }]);
        let noise = heat(40, 30, |x, y| ((x * 12.9 + y * 78.2).sin() * 43758.5).fract().abs());
        let peaks = noise.peaks::<2>(0.05);
        for (i, a) in peaks.iter().enumerate() {
            for b in &peaks[..i] {
                assert!(a.x.abs_diff(b.x) > 2 || a.y.abs_diff(b.y) > 2, "{a:?} {b:?}");
            }
        }
        assert!(peaks.len() > 20);
    }

    #[test]
    fn interpolation_is_linear_between_cells() {
        let ramp = heat(8, 6, |x, y| 0.1 * x + 0.2 * y);
        assert!((ramp.bilinear(2.5, 3.25) - 0.9).abs() < 1e-6);
        assert!((ramp.bilinear(-3.0, 99.0) - 1.0).abs() < 1e-6);
    }
}
