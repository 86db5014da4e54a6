//! Laws of the inverted file and of prototype_descriptors.

use rand::{RngExt, SeedableRng, rngs::StdRng};
use vision::{DescriptorError, DescriptorView, InvertedFile, Metric, distance, prototype_descriptors};

const METRICS: [(Metric, usize); 4] =
    [(Metric::Hamming, 32), (Metric::CosineInt8, 64), (Metric::Cosine, 64), (Metric::Euclidean, 64)];

/// Descriptors around a few hundred centres, as textures are.
fn clustered(metric: Metric, width: usize, count: usize, seed: u64) -> Vec<u8> {
    let mut random = StdRng::seed_from_u64(seed);
    let dimension = if metric.is_float() { width / 4 } else { width };
    let mut number = |size: f32| random.random_range(-size..size);
    let centres: Vec<Vec<f32>> = (0..200).map(|_| (0..dimension).map(|_| number(60.0)).collect()).collect();
    let near = |index: usize, number: &mut dyn FnMut(f32) -> f32| -> Vec<f32> {
        centres[index % centres.len()].iter().map(|x| x + number(30.0)).collect()
    };
    let mut random = StdRng::seed_from_u64(seed + 1);
    let mut number = |size: f32| random.random_range(-size..size);
    (0..count)
        .flat_map(|index| {
            let numbers = near(index, &mut number);
            match metric {
                Metric::Hamming => {
                    let bits = numbers.iter().chain(&numbers).map(|x| u8::from(*x > 0.0)).collect::<Vec<_>>();
                    let wide = bits.iter().cycle().take(8 * width).copied().collect::<Vec<_>>();
                    wide.chunks(8).map(|chunk| chunk.iter().fold(0, |byte, bit| byte << 1 | bit)).collect()
                }
                Metric::CosineInt8 => numbers.iter().map(|x| (*x as i8).cast_unsigned()).collect(),
                _ => numbers.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>(),
            }
        })
        .collect()
}

fn found(index: &InvertedFile, queries: DescriptorView<'_>, max_distance: f32) -> Vec<Vec<(u32, f32)>> {
    let mut all = Vec::new();
    index
        .search(queries, max_distance, |query, hits| {
            assert_eq!(query, all.len());
            let mut hits: Vec<_> = hits.iter().map(|hit| (hit.payload, hit.distance)).collect();
            hits.sort_by_key(|hit| hit.0);
            all.push(hits);
        })
        .unwrap();
    all
}

#[test]
fn what_is_found_is_as_near_as_said_and_most_of_what_is_near_is_found() {
    for (metric, width) in METRICS {
        let stored = clustered(metric, width, 4000, 1);
        let queries = clustered(metric, width, 300, 1);
        let view = |bytes| DescriptorView::new(metric, width, bytes).unwrap();
        let payloads: Vec<u32> = (0..4000).collect();
        let index = InvertedFile::build(view(&stored), &payloads).unwrap();
        let max_distance = if metric == Metric::Euclidean { 90.0 } else { 0.15 };
        let (mut near, mut seen) = (0, 0);
        for (query, hits) in queries.chunks(width).zip(found(&index, view(&queries), max_distance)) {
            for &(payload, apart) in &hits {
                let other = &stored[payload as usize * width..][..width];
                assert!(apart <= max_distance && (apart - distance(metric, query, other)).abs() < 1e-3);
            }
            assert!(hits.windows(2).all(|pair| pair[0].0 < pair[1].0), "one is found twice");
            near +=
                stored.chunks(width).filter(|other| distance(metric, query, other) <= max_distance).count();
            seen += hits.len();
        }
        assert!(near > 300 && seen as f64 >= 0.7 * near as f64, "{metric:?}: {seen} of {near}");
    }
}

#[test]
fn the_order_of_queries_does_not_matter_and_each_stored_one_finds_itself() {
    for (metric, width) in METRICS {
        let stored = clustered(metric, width, 1500, 3);
        let view = |bytes| DescriptorView::new(metric, width, bytes).unwrap();
        let payloads: Vec<u32> = (0..1500).collect();
        let index = InvertedFile::build(view(&stored), &payloads).unwrap();
        let there = found(&index, view(&stored), 0.01);
        assert!(there.iter().enumerate().all(|(own, hits)| hits.iter().any(|hit| hit.0 as usize == own)));
        let reversed: Vec<u8> = stored.chunks(width).rev().flatten().copied().collect();
        let mut back = found(&index, view(&reversed), 0.01);
        back.reverse();
        assert_eq!(there, back);
    }
}

#[test]
fn what_cannot_be_filed_or_searched_is_refused() {
    let view = DescriptorView::new(Metric::CosineInt8, 2, &[1, 2, 3, 4]).unwrap();
    assert!(matches!(InvertedFile::build(view, &[1]), Err(DescriptorError::Groups { .. })));
    let index = InvertedFile::build(view, &[1, 2]).unwrap();
    let wide = DescriptorView::new(Metric::CosineInt8, 4, &[1, 2, 3, 4]).unwrap();
    let bits = DescriptorView::new(Metric::Hamming, 2, &[1, 2]).unwrap();
    for other in [wide, bits] {
        assert!(matches!(index.search(other, 0.1, |_, _| {}), Err(DescriptorError::Mismatch { .. })));
    }
    let none = DescriptorView::new(Metric::CosineInt8, 2, &[]).unwrap();
    let empty = InvertedFile::build(none, &[]).unwrap();
    assert!(empty.is_empty() && found(&empty, view, 2.0).iter().all(Vec::is_empty));
}

#[test]
fn a_prototype_is_nearer_to_the_truth_than_the_observations_it_is_made_of() {
    let mut random = StdRng::seed_from_u64(5);
    let truth: Vec<u8> = (0..64).map(|_| random.random_range(-60..60_i8).cast_unsigned()).collect();
    let mut view = || -> Vec<u8> {
        truth.iter().map(|x| (x.cast_signed() + random.random_range(-30..30_i8)).cast_unsigned()).collect()
    };
    let views: Vec<Vec<u8>> = (0..6).map(|_| view()).collect();
    let seen = views.concat();
    let prototype = prototype_descriptors(DescriptorView::new(Metric::CosineInt8, 64, &seen).unwrap(), 0.5);
    assert_eq!(prototype.len(), 64);
    let apart = distance(Metric::CosineInt8, &prototype, &truth);
    assert!(views.iter().all(|view| apart < 0.5 * distance(Metric::CosineInt8, view, &truth)));
}
