//! Laws of the index.
#![allow(clippy::unwrap_used, missing_docs)]

use proptest::prelude::*;
use rand::{RngExt, SeedableRng, rngs::StdRng};
use vision::{Candidate, DescriptorError, Metric, MultiIndex, Sketcher, distance, hamming};

fn flipped(random: &mut StdRng, descriptor: &[u8], rate: f64) -> Vec<u8> {
    let mut flip = |byte: &u8| byte ^ (0..8).map(|bit| u8::from(random.random_bool(rate)) << bit).sum::<u8>();
    descriptor.iter().map(&mut flip).collect()
}

fn random_bytes(random: &mut StdRng, length: usize) -> Vec<u8> {
    (0..length).map(|_| random.random()).collect()
}

/// What brute force returns, in the promised order.
fn brute_force(stored: &[Vec<u8>], query: &[u8], max_distance: u32) -> Vec<Candidate> {
    let mut found: Vec<Candidate> = (0..)
        .zip(stored)
        .map(|(entry, descriptor)| Candidate {
            distance: hamming(descriptor, query),
            payload: entry / 3,
            entry,
        })
        .filter(|candidate| candidate.distance <= max_distance)
        .collect();
    found.sort_unstable();
    found
}

fn filled(width: usize, radius: u8, stored: &[Vec<u8>]) -> MultiIndex {
    let mut index = MultiIndex::with_radius(width, radius).unwrap();
    for (number, descriptor) in (0..).zip(stored) {
        index.insert(descriptor, number / 3).unwrap();
    }
    index
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn the_index_returns_a_part_of_brute_force_and_all_of_it_up_to_its_exact_distance(
        half_width in 1..25usize, radius in 0..3u8, seed: u64, share in 0.0..0.5f64,
    ) {
        let width = 2 * half_width;
        let mut random = StdRng::seed_from_u64(seed);
        let query = random_bytes(&mut random, width);
        let rates = [0.0, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.5];
        let stored: Vec<_> = (0..80).map(|i| flipped(&mut random, &query, rates[i % rates.len()])).collect();
        let index = filled(width, radius, &stored);
        let max_distance = (share * 8.0 * width as f64) as u32;
        let found = index.query(&query, max_distance).unwrap();
        let wanted = brute_force(&stored, &query, max_distance);
        prop_assert!(found.is_sorted());
        prop_assert!(found.iter().all(|candidate| wanted.contains(candidate)));
        for candidate in wanted.iter().filter(|candidate| candidate.distance <= index.exact_distance()) {
            prop_assert!(found.contains(candidate), "{candidate:?} is missing");
        }
        prop_assert_eq!(found.iter().filter(|c| found.iter().filter(|d| d.entry == c.entry).count() > 1).count(), 0);
    }
}

/// A descriptor of one chunk leaves the pigeonholes no luck: all that lies within the radius, and nothing else.
#[test]
fn every_way_to_flip_as_many_bits_as_the_radius_is_looked_up() {
    for radius in 0..3 {
        let mut index = MultiIndex::with_radius(2, radius).unwrap();
        index.insert(&[0x3c, 0x5a], 1).unwrap();
        for flips in 0..=u16::MAX {
            let [high, low] = flips.to_be_bytes();
            let found = index.query(&[0x3c ^ high, 0x5a ^ low], 16).unwrap();
            assert_eq!(found.len(), usize::from(flips.count_ones() <= u32::from(radius)), "{flips:b}");
        }
    }
}

/// Independent flips at a rate p keep a chunk within one flip with `q = (1-p)^16 + 16 p (1-p)^15`, and one of 16 chunks
/// with `1 - (1-q)^16`: 0.9999 at the recorded mean rate of 0.095, 0.998 at 0.14.
#[test]
fn recall_at_the_recorded_flip_rates() {
    let mut random = StdRng::seed_from_u64(11);
    let stored: Vec<_> = (0..20_000).map(|_| random_bytes(&mut random, 32)).collect();
    let index = filled(32, MultiIndex::DEFAULT_RADIUS, &stored);
    for (rate, bound) in [(0.095, 0.998), (0.14, 0.99)] {
        let recalled = (0..1000).filter(|&entry| {
            let query = flipped(&mut random, &stored[entry], rate);
            let found = index.query(&query, 64).unwrap();
            assert!(found.iter().all(|candidate| candidate.distance <= 64));
            found.iter().any(|candidate| candidate.entry as usize == entry)
        });
        let recall = recalled.count() as f64 / 1000.0;
        assert!(recall >= bound, "recall {recall} at {rate}");
    }
}

#[test]
fn another_width_is_refused() {
    assert!(matches!(MultiIndex::new(0), Err(DescriptorError::Width { .. })));
    assert!(matches!(MultiIndex::new(31), Err(DescriptorError::Width { .. })));
    let mut index = MultiIndex::new(32).unwrap();
    assert!(matches!(index.insert(&[0; 31], 0), Err(DescriptorError::Mismatch { .. })));
    assert!(matches!(index.query(&[0; 48], 5), Err(DescriptorError::Mismatch { .. })));
    assert!(index.is_empty());
}

#[test]
fn an_entry_gives_back_its_descriptor() {
    let mut index = MultiIndex::new(2).unwrap();
    index.insert(&[1, 2], 9).unwrap();
    assert_eq!(index.descriptor(0), Some(&[1, 2][..]));
    assert_eq!(index.descriptor(1), None);
}

fn random_unit(random: &mut StdRng, dimension: usize) -> Vec<f64> {
    let numbers: Vec<f64> = (0..dimension).map(|_| random.random_range(-1.0..1.0)).collect();
    let norm = numbers.iter().map(|x| x * x).sum::<f64>().sqrt();
    numbers.iter().map(|x| x / norm).collect()
}

/// A descriptor near another: `a + noise`, so at varying angles.
fn noisy(random: &mut StdRng, a: &[f64], noise: f64) -> Vec<f64> {
    a.iter().zip(random_unit(random, a.len())).map(|(x, e)| x + noise * e).collect()
}

fn to_bytes(numbers: &[f64]) -> Vec<u8> {
    numbers.iter().flat_map(|&number| (number as f32).to_le_bytes()).collect()
}

#[test]
fn sketches_measure_the_angle() {
    let mut random = StdRng::seed_from_u64(12);
    for dimension in [8, 128] {
        let sketcher = Sketcher::new(dimension, 3);
        for noise in [0.1, 0.5, 1.0, 3.0] {
            let mut error = 0.0;
            for _ in 0..200 {
                let a = random_unit(&mut random, dimension);
                let (a, b) = (to_bytes(&a), to_bytes(&noisy(&mut random, &a, noise)));
                let bits = hamming(&sketcher.sketch(&a).unwrap(), &sketcher.sketch(&b).unwrap());
                let expected = Sketcher::expected_bits(f64::from(distance(Metric::Cosine, &a, &b)));
                assert!((f64::from(bits) - expected).abs() < 45.0, "{bits} bits for {expected}");
                error += f64::from(bits) - expected;
            }
            assert!(
                (error / 200.0).abs() < 3.0,
                "dimension {dimension}, noise {noise}: bias {} bits",
                error / 200.0
            );
        }
    }
}

/// Float descriptors at cosine distances near 0.1 (26 degrees) are found through their sketches.
#[test]
fn float_descriptors_are_found_through_the_index() {
    let mut random = StdRng::seed_from_u64(13);
    let sketcher = Sketcher::new(128, 3);
    let stored: Vec<_> = (0..5000).map(|_| random_unit(&mut random, 128)).collect();
    let sketches: Vec<_> = stored.iter().map(|s| sketcher.sketch(&to_bytes(s)).unwrap().to_vec()).collect();
    let index = filled(32, MultiIndex::DEFAULT_RADIUS, &sketches);
    let recalled = (0..500).filter(|&entry| {
        let query = sketcher.sketch(&to_bytes(&noisy(&mut random, &stored[entry], 0.49))).unwrap();
        let found = index.query(&query, Sketcher::search_bits(0.1)).unwrap();
        found.first().is_some_and(|candidate| candidate.entry as usize == entry)
    });
    let recall = recalled.count() as f64 / 500.0;
    assert!(recall >= 0.97, "recall {recall}");
}

#[test]
fn the_same_seed_draws_the_same_hyperplanes_and_another_does_not() {
    let descriptor = to_bytes(&random_unit(&mut StdRng::seed_from_u64(14), 16));
    let sketch = |seed| Sketcher::new(16, seed).sketch(&descriptor).unwrap();
    assert_eq!(sketch(1), sketch(1));
    assert_ne!(sketch(1), sketch(2));
    assert!(Sketcher::new(16, 1).sketch(&descriptor[..60]).is_err());
}
