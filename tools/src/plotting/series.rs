//! Thinning and measuring of the numbers that are drawn.

use std::ops::Range;

/// More points than this on one line are not seen, only stored.
const MAX_POINTS: usize = 1600;
/// The share of an axis left free at either end.
const MARGIN: f64 = 0.06;

/// Thins a line to what can be seen: of each short stretch its lowest and its highest point.
pub(crate) fn thin(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    if points.len() <= MAX_POINTS {
        return points.to_vec();
    }
    let stretch = points.len().div_ceil(MAX_POINTS / 2);
    let mut thinned = Vec::with_capacity(MAX_POINTS);
    for part in points.chunks(stretch) {
        let by_height = |a: &&(f64, f64), b: &&(f64, f64)| a.1.total_cmp(&b.1);
        let (Some(low), Some(high)) = (part.iter().min_by(by_height), part.iter().max_by(by_height)) else {
            continue;
        };
        let (first, second) = if low.0 <= high.0 { (low, high) } else { (high, low) };
        thinned.push(*first);
        if first != second {
            thinned.push(*second);
        }
    }
    thinned
}

/// Thins a line in the plane, where no axis is time: every n-th point, and the last.
pub(crate) fn thin_path(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let step = points.len().div_ceil(MAX_POINTS).max(1);
    let mut thinned: Vec<_> = points.iter().copied().step_by(step).collect();
    thinned.extend(points.last().filter(|last| thinned.last() != Some(*last)));
    thinned
}

/// The range of some values with a margin; never empty.
pub(crate) fn range(values: impl Iterator<Item = f64>) -> Range<f64> {
    let (low, high) = values
        .filter(|value| value.is_finite())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
    if low > high {
        return -1.0..1.0;
    }
    let margin = ((high - low) * MARGIN).max(1e-6 * high.abs().max(low.abs())).max(1e-9);
    low - margin..high + margin
}

/// The value below which a share of all lie.
pub(crate) fn quantile(values: impl Iterator<Item = f64>, share: f64) -> Option<f64> {
    let mut sorted: Vec<f64> = values.filter(|value| value.is_finite()).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    let last = sorted.len().checked_sub(1)?;
    sorted.get((share * last as f64).round() as usize).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thinning_keeps_the_peaks_and_the_order() {
        let mut points: Vec<(f64, f64)> =
            (0..100_000).map(f64::from).map(|t| (t, (t * 1e-3).sin())).collect();
        points[54_321].1 = 9.0;
        points[12_345].1 = -9.0;
        let thinned = thin(&points);
        assert!(thinned.len() <= MAX_POINTS);
        assert!(thinned.contains(&points[54_321]) && thinned.contains(&points[12_345]));
        assert!(thinned.windows(2).all(|pair| pair[0].0 < pair[1].0));
        assert_eq!(thin(&points[..10]), points[..10]);
        assert_eq!(thin_path(&points).last(), points.last());
    }

    #[test]
    fn a_range_is_never_empty() {
        for values in [vec![], vec![3.0], vec![f64::NAN, 0.0], vec![-1.0, 2.0]] {
            let range = range(values.iter().copied());
            assert!(range.start < range.end && range.start.is_finite() && range.end.is_finite());
        }
    }
}
