//! The image as the network takes it.

use crate::features::layers::reader::EPSILON;
use crate::features::layers::{Layer, Map};
use crate::image::GrayImage;
use pulp::{Arch, NullaryFnOnce};

/// Columns and rows of the network's input are multiples of this.
pub(super) const MULTIPLE: usize = 32;

/// The 2x2 phases of an image with mean 0 and variance 1. An image whose sides are not multiples of 32 is continued to the right and
/// downwards by its last pixels.
pub(super) fn prepare(image: &GrayImage, map: &mut Map) {
    let padded = |side: usize| side.next_multiple_of(MULTIPLE);
    map.reshape(4, padded(image.height()) / 2, padded(image.width()) / 2);
    Arch::new().dispatch(Prepare { image, map });
}

struct Prepare<'a> {
    image: &'a GrayImage,
    map: &'a mut Map,
}

impl NullaryFnOnce for Prepare<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { image, map } = self;
        let (width, height) = (image.width(), image.height());
        let (columns, rows) = (2 * map.columns(), 2 * map.rows());
        let [mean, factor] = normalization(image, columns - width, rows - height);
        let mut row = vec![0; columns];
        for y in 0..rows {
            let pixels = image.row(y.min(height - 1));
            row[..width].copy_from_slice(pixels);
            row[width..].fill(pixels[width - 1]);
            for x in 0..2 {
                let phase = map.row_mut(Layer::phase(2, 0, [x, y % 2]), y / 2);
                for (number, pair) in phase.iter_mut().zip(row.as_chunks::<2>().0) {
                    *number = (f32::from(pair[x]) - mean) * factor;
                }
            }
        }
    }
}

/// The mean of the grey levels of the continued image, and the inverse of their standard deviation.
#[inline(always)]
fn normalization(image: &GrayImage, more_columns: usize, more_rows: usize) -> [f32; 2] {
    let (mut sum, mut squares) = (0, 0);
    for y in 0..image.height() {
        let row = image.row(y);
        let (last, more) = (u64::from(row[row.len() - 1]), more_columns as u64);
        let of_row: u32 = row.iter().map(|&pixel| u32::from(pixel)).sum();
        let squares_of_row: u32 = row.iter().map(|&pixel| u32::from(pixel) * u32::from(pixel)).sum();
        let times = if y + 1 == image.height() { 1 + more_rows as u64 } else { 1 };
        sum += times * (u64::from(of_row) + more * last);
        squares += times * (u64::from(squares_of_row) + more * last * last);
    }
    let count = ((image.width() + more_columns) * (image.height() + more_rows)) as f64;
    let mean = sum as f64 / count;
    let variance = (squares as f64 / count - mean * mean).max(0.0);
    // The network was trained with grey levels from 0 to 1.
    let epsilon = f64::from(EPSILON) * 255.0 * 255.0;
    [mean as f32, (variance + epsilon).sqrt().recip() as f32]
}
