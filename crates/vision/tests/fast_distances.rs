//! The fast loops over many descriptors against the definition of the distance.

use rand::{RngExt, SeedableRng, rngs::StdRng};
use vision::{DescriptorView, InvertedFile, MatchOptions, Matcher, Metric, distance, match_descriptors};

/// Widths below, at and beside those that have loops of their own.
const WIDTHS: [(Metric, &[usize]); 4] = [
    (Metric::Hamming, &[1, 8, 29, 32, 64]),
    (Metric::CosineInt8, &[1, 7, 16, 48, 60, 64, 100, 128, 256]),
    (Metric::Cosine, &[4, 60, 64, 256, 512]),
    (Metric::Euclidean, &[4, 60, 64, 256, 512]),
];

fn descriptors(metric: Metric, width: usize, count: usize, random: &mut StdRng) -> Vec<u8> {
    if metric.is_float() {
        let numbers = (0..count * width / 4).map(|_| random.random_range(-1.0..1.0_f32));
        return numbers.flat_map(f32::to_le_bytes).collect();
    }
    // All bytes, -128 included.
    (0..count * width).map(|_| random.random()).collect()
}

#[test]
fn matching_finds_the_nearest_by_the_definition_at_every_width_and_count() {
    let anything = MatchOptions { max_distance: f32::MAX, ratio: None, mutual: false };
    let mut random = StdRng::seed_from_u64(1);
    for (metric, widths) in WIDTHS {
        for &width in widths {
            for count in [1, 2, 3, 4, 5, 31, 33, 70] {
                let query = descriptors(metric, width, 9, &mut random);
                let train = descriptors(metric, width, count, &mut random);
                let view = |bytes| DescriptorView::new(metric, width, bytes).unwrap();
                let found = match_descriptors(view(&query), view(&train), &anything).unwrap();
                let mutual = MatchOptions { mutual: true, ..anything };
                let mutual = match_descriptors(view(&query), view(&train), &mutual).unwrap();
                assert_eq!(found.len(), 9);
                let apart = |query_at: usize, train_at: usize| {
                    let [a, b] =
                        [(&query, query_at), (&train, train_at)].map(|(all, at)| &all[at * width..][..width]);
                    distance(metric, a, b)
                };
                for one in &found {
                    let nearest = (0..count).map(|at| apart(one.query, at)).fold(f32::INFINITY, f32::min);
                    assert!((one.distance - nearest).abs() < 1e-4, "{metric:?} {width} {count}");
                    assert!((apart(one.query, one.train) - nearest).abs() < 1e-4);
                    let back = (0..9).map(|at| apart(at, one.train)).fold(f32::INFINITY, f32::min);
                    if mutual.contains(one) {
                        assert!(one.distance <= back + 1e-4);
                    } else {
                        assert!(one.distance >= back - 1e-4);
                    }
                }
            }
        }
    }
}

#[test]
fn a_matcher_that_was_used_finds_what_a_new_one_finds() {
    let anything = MatchOptions { max_distance: f32::MAX, ratio: None, mutual: true };
    let mut random = StdRng::seed_from_u64(4);
    for (metric, widths) in WIDTHS {
        for &width in widths {
            let query = descriptors(metric, width, 21, &mut random);
            let query = DescriptorView::new(metric, width, &query).unwrap();
            let mut used = Matcher::new(query);
            // Fewer and more than before, and none.
            for count in [70, 3, 0, 17, 64, 16] {
                let train = descriptors(metric, width, count, &mut random);
                let train = DescriptorView::new(metric, width, &train).unwrap();
                let matches = used.matches(train, &anything).unwrap();
                assert_eq!(matches, match_descriptors(query, train, &anything).unwrap());
                // The nearest pair of all is mutual.
                assert_eq!(matches.is_empty(), count == 0, "{metric:?} {width} {count}");
            }
        }
    }
    let narrow = DescriptorView::new(Metric::Hamming, 8, &[0; 8]).unwrap();
    let wide = DescriptorView::new(Metric::Hamming, 16, &[0; 16]).unwrap();
    assert!(Matcher::new(narrow).matches(wide, &anything).is_err());
}

#[test]
fn scalar_products_of_signed_bytes_are_exact() {
    let mut random = StdRng::seed_from_u64(2);
    let extreme: Vec<u8> = (0..64).map(|_| if random.random() { 0x80 } else { 0x7f }).collect();
    let view = |bytes| DescriptorView::new(Metric::CosineInt8, 64, bytes).unwrap();
    let anything = MatchOptions { max_distance: f32::MAX, ratio: None, mutual: false };
    let train = descriptors(Metric::CosineInt8, 64, 8, &mut random);
    for (at, one) in train.chunks_exact(64).enumerate() {
        let found = match_descriptors(view(&extreme), view(one), &anything).unwrap();
        assert_eq!(
            found[0].distance.to_bits(),
            distance(Metric::CosineInt8, &extreme, one).to_bits(),
            "{at}"
        );
    }
}

#[test]
fn what_the_inverted_file_finds_has_the_distance_of_the_definition() {
    let mut random = StdRng::seed_from_u64(3);
    for (metric, widths) in WIDTHS {
        for &width in widths {
            let stored = descriptors(metric, width, 300, &mut random);
            let view = DescriptorView::new(metric, width, &stored).unwrap();
            let payloads: Vec<u32> = (0..300).collect();
            let index = InvertedFile::build(view, &payloads).unwrap();
            let mut own = 0;
            let search = index.search(view, f32::MAX, |query, hits| {
                for hit in hits {
                    let [a, b] = [query, hit.payload as usize].map(|at| &stored[at * width..][..width]);
                    assert!((hit.distance - distance(metric, a, b)).abs() < 1e-4, "{metric:?} {width}");
                    own += usize::from(hit.payload as usize == query);
                }
            });
            search.unwrap();
            assert_eq!(own, 300, "{metric:?} {width}: a stored descriptor does not find itself");
        }
    }
}
