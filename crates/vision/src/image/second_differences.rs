//! Second mixed differences: what is left of an image where broad structure is taken away, mostly noise.

/// The second mixed differences in a row: of differences across three rows, those along the row. Their weights have the norm 6.
///
/// # Arguments
/// * `rows`: above, the row, below.
/// * `step`: pixels to the left and to the right.
/// * `columns`: as many numbers as a row has pixels.
#[inline(always)]
pub(crate) fn second_differences<'a>(
    [above, row, below]: [&[u8]; 3],
    step: usize,
    columns: &'a mut [i16],
) -> impl Iterator<Item = i16> + use<'a> {
    for (second, ((&a, &b), &c)) in columns.iter_mut().zip(above.iter().zip(row).zip(below)) {
        *second = i16::from(a) - 2 * i16::from(b) + i16::from(c);
    }
    columns.windows(2 * step + 1).map(move |d| d[0] - 2 * d[step] + d[2 * step])
}
