//! Local maxima of the scores.

use crate::features::layers::{Layer, Map};
use pulp::{Arch, NullaryFnOnce};

/// Radius of non-maximum suppression (5 x 5), as published.
const RADIUS: usize = 2;
/// Side of the square.
const SIDE: usize = 2 * RADIUS + 1;

/// Scores of all pixels.
#[derive(Default)]
pub(super) struct Scores {
    columns: usize,
    rows: usize,
    data: Vec<f32>,
}

/// A local maximum.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Peak {
    pub x: usize,
    pub y: usize,
    pub score: f32,
}

impl Scores {
    /// Takes over the four phases of a map.
    pub fn fill(&mut self, phases: &Map) {
        (self.columns, self.rows) = (2 * phases.columns(), 2 * phases.rows());
        self.data.resize(self.columns * self.rows, 0.0);
        Arch::new().dispatch(Fill { scores: self, phases });
    }

    /// A row of pixels.
    pub fn row(&self, y: usize) -> &[f32] {
        &self.data[y * self.columns..(y + 1) * self.columns]
    }

    /// Every pixel above `least` that is the greatest of the square around it, row by row; of equal ones the first. None is nearer than
    /// `border` to a side of an image of `width` x `height` pixels, which may be smaller than the map.
    pub fn peaks(&self, least: f32, border: usize, [width, height]: [usize; 2]) -> Vec<Peak> {
        Arch::new().dispatch(Find { scores: self, least, border, width, height })
    }

    /// Whether no pixel before this one in its square is as great.
    fn is_first(&self, x: usize, y: usize) -> bool {
        let own = self.row(y)[x];
        let (left, right) = (x.saturating_sub(RADIUS), (x + RADIUS).min(self.columns - 1));
        let above =
            (y.saturating_sub(RADIUS)..y).all(|row| self.row(row)[left..=right].iter().all(|&n| n < own));
        above && self.row(y)[left..x].iter().all(|&number| number < own)
    }

    /// Sub-pixel position of a peak: vertex of the parabola through it and its two neighbours, along each axis.
    pub fn refine(&self, peak: Peak) -> [f32; 2] {
        let (x, y) = (peak.x, peak.y);
        let row = self.row(y);
        let dx = vertex(row[x - 1], peak.score, row[x + 1]);
        let dy = vertex(self.row(y - 1)[x], peak.score, self.row(y + 1)[x]);
        [x as f32 + dx, y as f32 + dy]
    }
}

struct Fill<'a> {
    scores: &'a mut Scores,
    phases: &'a Map,
}

impl NullaryFnOnce for Fill<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { scores, phases } = self;
        for (y, row) in scores.data.chunks_exact_mut(scores.columns).enumerate() {
            let of = |x| phases.row(Layer::phase(2, 0, [x, y % 2]), y / 2);
            for ((pair, &left), &right) in row.as_chunks_mut::<2>().0.iter_mut().zip(of(0)).zip(of(1)) {
                *pair = [left, right];
            }
        }
    }
}

struct Find<'a> {
    scores: &'a Scores,
    least: f32,
    border: usize,
    width: usize,
    height: usize,
}

impl NullaryFnOnce for Find<'_> {
    type Output = Vec<Peak>;

    #[inline(always)]
    fn call(self) -> Vec<Peak> {
        let Self { scores, least, border, width, height } = self;
        let columns = scores.columns;
        let mut peaks = Vec::new();
        // The greatest of each pixel and its neighbours in the row, of five rows.
        let mut ring = vec![f32::NEG_INFINITY; SIDE * columns];
        let mut greatest = vec![0.0; columns];
        let mut is_peak = vec![false; columns];
        for below in 0..scores.rows + RADIUS {
            let slot = &mut ring[below % SIDE * columns..][..columns];
            if below < scores.rows {
                along_row(scores.row(below), slot);
            } else {
                slot.fill(f32::NEG_INFINITY);
            }
            let Some(y) = below.checked_sub(RADIUS) else { continue };
            if y < border || y + border >= height {
                continue;
            }
            greatest.copy_from_slice(&ring[..columns]);
            for row in ring.chunks_exact(columns).skip(1) {
                for (greatest, &number) in greatest.iter_mut().zip(row) {
                    *greatest = larger(*greatest, number);
                }
            }
            let row = scores.row(y);
            for ((is_peak, &score), &greatest) in is_peak.iter_mut().zip(row).zip(&greatest) {
                *is_peak = score >= greatest;
            }
            let inside = border..width.saturating_sub(border);
            for x in inside.filter(|&x| is_peak[x]) {
                if row[x] > least && scores.is_first(x, y) {
                    peaks.push(Peak { x, y, score: row[x] });
                }
            }
        }
        peaks
    }
}

/// The greatest of each number and its two neighbours on either side.
#[inline(always)]
fn along_row(row: &[f32], greatest: &mut [f32]) {
    greatest.copy_from_slice(row);
    for shift in 1..=RADIUS {
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

/// Vertex of the parabola through three values at -1, 0 and 1, within half a pixel.
fn vertex(before: f32, top: f32, after: f32) -> f32 {
    let curvature = before - 2.0 * top + after;
    if curvature < 0.0 { (0.5 * (before - after) / curvature).clamp(-0.5, 0.5) } else { 0.0 }
}
