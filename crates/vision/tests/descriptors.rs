//! Laws of distances.

use proptest::prelude::*;
use vision::{DescriptorError, DescriptorView, MatchOptions, Metric, distance, hamming, match_descriptors};

fn to_bytes(numbers: &[f32]) -> Vec<u8> {
    numbers.iter().flat_map(|number| number.to_le_bytes()).collect()
}

/// Pairs of byte strings of one length, words and left-over bytes.
fn byte_pair() -> impl Strategy<Value = (Vec<u8>, Vec<u8>)> {
    (1..80usize).prop_flat_map(|length| (any_bytes(length), any_bytes(length)))
}

fn any_bytes(length: usize) -> impl Strategy<Value = Vec<u8>> {
    prop::collection::vec(any::<u8>(), length)
}

fn float_pair() -> impl Strategy<Value = (Vec<f32>, Vec<f32>)> {
    (1..40usize).prop_flat_map(|dimension| (any_floats(dimension), any_floats(dimension)))
}

fn any_floats(dimension: usize) -> impl Strategy<Value = Vec<f32>> {
    prop::collection::vec(-10.0..10.0f32, dimension)
}

proptest! {
    #[test]
    fn hamming_counts_the_bits_that_differ((a, b) in byte_pair()) {
        let bits = |bytes: &[u8]| (0..8 * bytes.len()).map(|i| bytes[i / 8] >> (i % 8) & 1).collect::<Vec<_>>();
        let counted = bits(&a).iter().zip(bits(&b)).filter(|(x, y)| **x != *y).count();
        prop_assert_eq!(hamming(&a, &b) as usize, counted);
        prop_assert_eq!(hamming(&a, &a), 0);
    }

    #[test]
    fn every_distance_is_symmetric((a, b) in float_pair()) {
        let (a, b) = (to_bytes(&a), to_bytes(&b));
        for metric in [Metric::Hamming, Metric::Cosine, Metric::Euclidean] {
            prop_assert_eq!(distance(metric, &a, &b).to_bits(), distance(metric, &b, &a).to_bits());
        }
    }

    #[test]
    fn cosine_distance_does_not_see_length((a, b) in float_pair(), scale in 0.1..10.0f32) {
        let scaled: Vec<f32> = a.iter().map(|x| x * scale).collect();
        let before = distance(Metric::Cosine, &to_bytes(&a), &to_bytes(&b));
        let after = distance(Metric::Cosine, &to_bytes(&scaled), &to_bytes(&b));
        prop_assert!((before - after).abs() < 1e-5);
    }

    #[test]
    fn cosine_distance_is_half_the_squared_euclidean_distance_of_unit_vectors((a, b) in float_pair()) {
        let unit = |numbers: &[f32]| {
            let norm = numbers.iter().map(|x| x * x).sum::<f32>().sqrt();
            to_bytes(&numbers.iter().map(|x| x / norm.max(1e-6)).collect::<Vec<_>>())
        };
        prop_assume!(a.iter().any(|x| x.abs() > 0.1) && b.iter().any(|x| x.abs() > 0.1));
        let cosine = distance(Metric::Cosine, &unit(&a), &unit(&b));
        let euclidean = distance(Metric::Euclidean, &unit(&a), &unit(&b));
        prop_assert!((cosine - euclidean * euclidean / 2.0).abs() < 1e-5);
    }

    /// Matching converts the descriptors once; its distances are those of the definition.
    #[test]
    fn matching_measures_the_same_distances((a, b) in float_pair()) {
        for metric in [Metric::Hamming, Metric::Cosine, Metric::Euclidean] {
            let (a, b) = (to_bytes(&a), to_bytes(&b));
            let view = |bytes| DescriptorView::new(metric, a.len(), bytes).unwrap();
            let options = MatchOptions { max_distance: f32::MAX, ratio: None, mutual: false };
            let found = match_descriptors(view(&a), view(&b), &options).unwrap();
            prop_assert!((found[0].distance - distance(metric, &a, &b)).abs() < 1e-4);
        }
    }
}

#[test]
fn a_descriptor_without_length_is_unrelated_to_all() {
    assert_eq!(
        distance(Metric::Cosine, &to_bytes(&[0.0, 0.0]), &to_bytes(&[1.0, 0.0])).to_bits(),
        1.0f32.to_bits()
    );
}

#[test]
fn what_is_not_a_list_of_descriptors_is_refused() {
    let bytes = [0; 12];
    let width = |metric, width| DescriptorView::new(metric, width, &bytes);
    assert!(matches!(width(Metric::Hamming, 0), Err(DescriptorError::Width { .. })));
    assert!(matches!(width(Metric::Cosine, 6), Err(DescriptorError::Width { .. })));
    assert!(matches!(width(Metric::Hamming, 5), Err(DescriptorError::Length { .. })));
    assert_eq!(width(Metric::Hamming, 3).unwrap().len(), 4);
    assert_eq!(width(Metric::Hamming, 3).unwrap().get(4), None);
    assert_eq!(width(Metric::Hamming, 3).unwrap().get(usize::MAX), None);
}
