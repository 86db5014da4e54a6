//! Feature maps at other resolutions.

use super::layer::Layer;
use super::map::Map;
use pulp::{Arch, NullaryFnOnce};

/// Means of squares of `SIDE` x `SIDE` numbers. What does not fill a square at the right and at the bottom is left out.
pub fn average<const SIDE: usize>(input: &Map, output: &mut Map) {
    output.reshape(input.channels(), input.rows() / SIDE, input.columns() / SIDE);
    Arch::new().dispatch(Average::<SIDE> { input, output });
}

struct Average<'a, const SIDE: usize> {
    input: &'a Map,
    output: &'a mut Map,
}

impl<const SIDE: usize> NullaryFnOnce for Average<'_, SIDE> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { input, output } = self;
        let mut sums = vec![0.0_f32; output.columns() * SIDE];
        for y in 0..output.rows() {
            for channel in 0..output.channels() {
                sums.copy_from_slice(&input.row(channel, y * SIDE)[..output.columns() * SIDE]);
                for below in 1..SIDE {
                    for (sum, number) in sums.iter_mut().zip(input.row(channel, y * SIDE + below)) {
                        *sum += number;
                    }
                }
                let squares = sums.as_chunks::<SIDE>().0;
                for (mean, square) in output.row_mut(channel, y).iter_mut().zip(squares) {
                    *mean = square.iter().sum::<f32>() / (SIDE * SIDE) as f32;
                }
            }
        }
    }
}

/// The phases of each channel as channels ([`Layer::phase`]): what a convolution of stride `SIDE` takes as its input.
pub fn split<const SIDE: usize>(input: &Map, output: &mut Map) {
    output.reshape(input.channels() * SIDE * SIDE, input.rows() / SIDE, input.columns() / SIDE);
    Arch::new().dispatch(Split::<SIDE> { input, output });
}

struct Split<'a, const SIDE: usize> {
    input: &'a Map,
    output: &'a mut Map,
}

impl<const SIDE: usize> NullaryFnOnce for Split<'_, SIDE> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { input, output } = self;
        for y in 0..output.rows() * SIDE {
            for channel in 0..input.channels() {
                let squares = input.row(channel, y).as_chunks::<SIDE>().0;
                for x in 0..SIDE {
                    let phase = output.row_mut(Layer::phase(SIDE, channel, [x, y % SIDE]), y / SIDE);
                    for (number, square) in phase.iter_mut().zip(squares) {
                        *number = square[x];
                    }
                }
            }
        }
    }
}

/// Adds a map with `FACTOR` times as many rows and columns, linear between the centres of pixels; the border is replicated.
///
/// # Panics
/// If `FACTOR` is odd or the output is not `FACTOR` times as large.
pub fn add_enlarged<const FACTOR: usize>(input: &Map, output: &mut Map) {
    let shape = |map: &Map, factor| [map.channels(), map.rows() * factor, map.columns() * factor];
    assert!(FACTOR.is_multiple_of(2) && shape(input, FACTOR) == shape(output, 1), "{FACTOR} times as large");
    Arch::new().dispatch(Enlarge::<FACTOR> { input, output });
}

struct Enlarge<'a, const FACTOR: usize> {
    input: &'a Map,
    output: &'a mut Map,
}

impl<const FACTOR: usize> NullaryFnOnce for Enlarge<'_, FACTOR> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { input, output } = self;
        let columns = output.columns();
        let mut wide = [(); 2].map(|()| vec![0.0; columns * input.channels()]);
        let mut next = 0;
        for y in 0..output.rows() {
            let ([top, bottom], weight) = neighbours(y, FACTOR, input.rows());
            // Rows of the input come one after the other; the first is above itself.
            while next <= bottom {
                wide.swap(0, 1);
                widen::<FACTOR>(input, next, &mut wide[1]);
                next += 1;
            }
            let upper = if top == bottom { &wide[1] } else { &wide[0] };
            for channel in 0..input.channels() {
                let at = channel * columns..(channel + 1) * columns;
                let rows = upper[at.clone()].iter().zip(&wide[1][at]);
                for (sum, (upper, lower)) in output.row_mut(channel, y).iter_mut().zip(rows) {
                    *sum += upper + weight * (lower - upper);
                }
            }
        }
    }
}

/// The pixels before and after the centre of pixel `at` of an enlarged row or column of `size` pixels, and the weight of the latter.
pub(crate) fn neighbours(at: usize, factor: usize, size: usize) -> ([usize; 2], f32) {
    let place = ((at as f32 + 0.5) / factor as f32 - 0.5).clamp(0.0, (size - 1) as f32);
    ([place.floor() as usize, place.ceil() as usize], place.fract())
}

/// A row of each channel with `FACTOR` times as many columns.
#[inline(always)]
fn widen<const FACTOR: usize>(input: &Map, y: usize, wide: &mut [f32]) {
    let weights: [f32; FACTOR] = std::array::from_fn(|k| (k as f32 + 0.5) / FACTOR as f32);
    for (channel, wide) in wide.chunks_exact_mut(input.columns() * FACTOR).enumerate() {
        let row = input.row(channel, y);
        let (first, last) = (row[0], row[row.len() - 1]);
        let (left, rest) = wide.split_at_mut(FACTOR / 2);
        let (between, right) = rest.as_chunks_mut::<FACTOR>();
        left.fill(first);
        right.fill(last);
        for ((between, a), b) in between.iter_mut().zip(row).zip(&row[1..]) {
            for (number, weight) in between.iter_mut().zip(weights) {
                *number = a + weight * (b - a);
            }
        }
    }
}
