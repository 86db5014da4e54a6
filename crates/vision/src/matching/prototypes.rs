//! Prototype descriptors: few descriptors that represent all observations of one landmark.

use super::descriptors::{DescriptorView, Metric, distance, floats, signed};

/// Clusters descriptors of one landmark and returns the mean of each cluster.
///
/// Leader clustering: each descriptor joins the first cluster whose first descriptor is within `max_distance`, or
/// starts a new one. The mean of binary descriptors is the majority of each bit (of a tie, the first descriptor's bit);
/// cosine metrics average unit vectors; means of signed bytes are scaled so that the largest magnitude is 127.
///
/// # Arguments
/// * `observed`: all descriptors of the landmark.
/// * `max_distance`: in the unit of the [`Metric`].
///
/// # Returns
/// Descriptors of the same metric and width, one after the other, in order of first observation.
///
/// # Example
/// ```
/// use vision::{DescriptorView, Metric};
/// let observed = DescriptorView::new(Metric::Hamming, 1, &[0b0000_1111, 0b0000_1110, 0b0000_1111, 0b1111_0000])?;
/// assert_eq!(vision::prototype_descriptors(observed, 0.25), [0b0000_1111, 0b1111_0000]);
/// # Ok::<(), vision::DescriptorError>(())
/// ```
pub fn prototype_descriptors(observed: DescriptorView<'_>, max_distance: f32) -> Vec<u8> {
    let mut clusters: Vec<Vec<&[u8]>> = Vec::new();
    for descriptor in &observed {
        match clusters
            .iter_mut()
            .find(|cluster| distance(observed.metric(), cluster[0], descriptor) <= max_distance)
        {
            Some(cluster) => cluster.push(descriptor),
            None => clusters.push(vec![descriptor]),
        }
    }
    clusters.iter().flat_map(|cluster| mean(observed.metric(), cluster)).collect()
}

fn mean(metric: Metric, cluster: &[&[u8]]) -> Vec<u8> {
    if let [only] = cluster {
        return only.to_vec();
    }
    match metric {
        Metric::Hamming => majority(cluster),
        Metric::CosineInt8 => {
            let sum = sum_of_units(cluster.iter().map(|bytes| signed(bytes).collect()));
            let largest = sum.iter().fold(0.0_f32, |largest, number| largest.max(number.abs()));
            let scale = if largest > 0.0 { 127.0 / largest } else { 0.0 };
            sum.iter().map(|number| ((number * scale).round() as i8).cast_unsigned()).collect()
        }
        Metric::Cosine => {
            let sum = sum_of_units(cluster.iter().map(|bytes| floats(bytes).collect()));
            sum.iter().flat_map(|number| number.to_le_bytes()).collect()
        }
        Metric::Euclidean => {
            let mut sum = vec![0.0; cluster[0].len() / 4];
            for bytes in cluster {
                sum.iter_mut().zip(floats(bytes)).for_each(|(sum, number)| *sum += number);
            }
            sum.iter().flat_map(|sum| (sum / cluster.len() as f32).to_le_bytes()).collect()
        }
    }
}

fn majority(cluster: &[&[u8]]) -> Vec<u8> {
    let bit = |index: usize, at: usize| {
        let ones = cluster.iter().filter(|bytes| bytes[index] >> at & 1 == 1).count();
        match (2 * ones).cmp(&cluster.len()) {
            std::cmp::Ordering::Less => 0,
            std::cmp::Ordering::Equal => cluster[0][index] >> at & 1,
            std::cmp::Ordering::Greater => 1,
        }
    };
    (0..cluster[0].len()).map(|index| (0..8).fold(0, |byte, at| byte | bit(index, at) << at)).collect()
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
