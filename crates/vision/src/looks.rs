//! What a thing looks like that was described several times: few descriptors that stand for many.

use crate::descriptors::{DescriptorView, Metric, distance, floats, signed};

/// The looks of one thing: descriptors near each other are one look, which is their mean.
///
/// Each descriptor joins the first look whose first descriptor is within `max_distance`, else it begins a look of its
/// own. The mean of bits is their majority (of a tie, the first descriptor's bit); of signed bytes it is scaled so that
/// the largest number is 127.
///
/// ```
/// use vision::{DescriptorView, Metric};
/// let seen = DescriptorView::new(Metric::Hamming, 1, &[0b0000_1111, 0b0000_1110, 0b0000_1111, 0b1111_0000])?;
/// assert_eq!(vision::looks(seen, 0.25), [0b0000_1111, 0b1111_0000]);
/// # Ok::<(), vision::DescriptorError>(())
/// ```
///
/// # Returns
/// Descriptors of the same metric and width, one after the other.
pub fn looks(seen: DescriptorView<'_>, max_distance: f32) -> Vec<u8> {
    let mut groups: Vec<Vec<&[u8]>> = Vec::new();
    for descriptor in &seen {
        match groups.iter_mut().find(|group| distance(seen.metric(), group[0], descriptor) <= max_distance) {
            Some(group) => group.push(descriptor),
            None => groups.push(vec![descriptor]),
        }
    }
    groups.iter().flat_map(|group| mean(seen.metric(), group)).collect()
}

fn mean(metric: Metric, group: &[&[u8]]) -> Vec<u8> {
    if let [only] = group {
        return only.to_vec();
    }
    match metric {
        Metric::Hamming => majority(group),
        Metric::CosineInt8 => {
            let sum = sum_of_units(group.iter().map(|bytes| signed(bytes).collect()));
            let largest = sum.iter().fold(0.0_f32, |largest, number| largest.max(number.abs()));
            let scale = if largest > 0.0 { 127.0 / largest } else { 0.0 };
            sum.iter().map(|number| ((number * scale).round() as i8).cast_unsigned()).collect()
        }
        Metric::Cosine => {
            let sum = sum_of_units(group.iter().map(|bytes| floats(bytes).collect()));
            sum.iter().flat_map(|number| number.to_le_bytes()).collect()
        }
        Metric::Euclidean => {
            let mut sum = vec![0.0; group[0].len() / 4];
            for bytes in group {
                sum.iter_mut().zip(floats(bytes)).for_each(|(sum, number)| *sum += number);
            }
            sum.iter().flat_map(|sum| (sum / group.len() as f32).to_le_bytes()).collect()
        }
    }
}

fn majority(group: &[&[u8]]) -> Vec<u8> {
    let bit = |index: usize, at: usize| {
        let ones = group.iter().filter(|bytes| bytes[index] >> at & 1 == 1).count();
        match (2 * ones).cmp(&group.len()) {
            std::cmp::Ordering::Less => 0,
            std::cmp::Ordering::Equal => group[0][index] >> at & 1,
            std::cmp::Ordering::Greater => 1,
        }
    };
    (0..group[0].len()).map(|index| (0..8).fold(0, |byte, at| byte | bit(index, at) << at)).collect()
}

/// Sum of the vectors, each scaled to norm 1.
fn sum_of_units(vectors: impl Iterator<Item = Vec<f32>>) -> Vec<f32> {
    let mut sum: Vec<f32> = Vec::new();
    for vector in vectors {
        sum.resize(vector.len(), 0.0);
        let norm = vector.iter().map(|number| number * number).sum::<f32>().sqrt();
        if norm > 0.0 {
            sum.iter_mut().zip(&vector).for_each(|(sum, number)| *sum += number / norm);
        }
    }
    sum
}
