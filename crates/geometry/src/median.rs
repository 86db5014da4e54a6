//! The median.

/// The median of some values, whose order changes: of an even number of them the upper one of both in the middle.
///
/// # Returns
/// `None` without values.
///
/// ```
/// assert_eq!(geometry::median(&mut [4.0, 1.0, 3.0]), Some(3.0));
/// assert_eq!(geometry::median(&mut [4.0, 1.0, 3.0, 2.0]), Some(3.0));
/// assert_eq!(geometry::median(&mut []), None);
/// ```
pub fn median(values: &mut [f64]) -> Option<f64> {
    let middle = values.len() / 2;
    // By the total order a NaN is beyond all numbers, and takes part as such.
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}
