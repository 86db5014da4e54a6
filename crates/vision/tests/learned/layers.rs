//! Layers equal plain loops over all numbers.

use crate::reference::Map as Plain;
use proptest::prelude::*;
use rand::{RngExt, SeedableRng as _, rngs::Xoshiro256PlusPlus};
use vision::features::layers::product::Matrix;
use vision::features::layers::resampling::{add_enlarged, average, split};
use vision::features::layers::{Convolution, Layer, Map};

/// Kernel size, stride, padding and dilation.
const KINDS: [[usize; 4]; 11] = [
    [1, 1, 0, 1],
    [3, 1, 1, 1],
    [3, 2, 1, 1],
    [4, 2, 1, 1],
    [2, 2, 0, 1],
    [4, 4, 0, 1],
    [8, 8, 0, 1],
    [1, 2, 0, 1],
    [3, 1, 2, 2],
    [3, 1, 4, 4],
    [2, 1, 8, 16],
];

fn random(count: usize, seed: u64) -> Vec<f32> {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    (0..count).map(|_| random.random_range(-1.0..1.0)).collect()
}

fn plain(channels: usize, rows: usize, columns: usize, seed: u64) -> Plain {
    Plain { channels, rows, columns, data: random(channels * rows * columns, seed) }
}

/// As a map whose channels are the phases of each channel.
fn phases(plain: &Plain, stride: usize) -> Map {
    let split = plain.split(stride);
    let mut map = Map::zeros(split.channels, split.rows, split.columns);
    for channel in 0..split.channels {
        for y in 0..split.rows {
            for (x, number) in map.row_mut(channel, y).iter_mut().enumerate() {
                *number = split.get(channel, y, x);
            }
        }
    }
    map
}

fn assert_equal(map: &Map, plain: &Plain, tolerance: f32) {
    assert_eq!([map.channels(), map.rows(), map.columns()], [plain.channels, plain.rows, plain.columns]);
    for channel in 0..map.channels() {
        for y in 0..map.rows() {
            for (x, &number) in map.row(channel, y).iter().enumerate() {
                let expected = plain.get(channel, y, x);
                assert!(
                    (number - expected).abs() <= tolerance,
                    "{channel} {y} {x}: {number}, not {expected}"
                );
            }
        }
    }
}

proptest! {
    #[test]
    fn a_layer_equals_the_loop_over_its_kernel(
        kind in 0..KINDS.len(), inputs in 1..7_usize, outputs in 1..11_usize,
        rows in 1..7_usize, columns in 1..60_usize, relu: bool, adds: bool, seed: u64,
    ) {
        let [side, stride, padding, dilation] = KINDS[kind];
        let shape = [outputs, inputs, side, side];
        let weights = random(shape.iter().product(), seed ^ 1);
        let bias = random(outputs, seed ^ 2);
        let input = plain(inputs, rows * stride, columns * stride, seed);
        let added = plain(outputs, rows, columns, seed ^ 3);
        let mut expected = input.convolve(&shape, &weights, &bias, [stride, padding, dilation]);
        if adds {
            expected = expected.add(&added);
        }
        if relu {
            expected = expected.map(|number| number.max(0.0));
        }
        let layer = Layer::new(&Convolution { shape, weights, bias, stride, padding, dilation });
        let added = phases(&added, 1);
        // What was in the output before, of this or another shape, does not matter.
        let mut output = phases(&plain(outputs, rows, columns + usize::from(adds), seed), 1);
        for _ in 0..2 {
            layer.run(&phases(&input, stride), adds.then_some(&added), relu, &mut output);
            assert_equal(&output, &expected, 1e-5 * (inputs * side * side) as f32);
        }
        // Its border is zero, so that it can be the input of the next layer.
        let next = [1, outputs, 3, 3];
        let weights = random(next.iter().product(), seed ^ 4);
        let expected = expected.convolve(&next, &weights, &[0.0], [1, 1, 1]);
        let layer = Layer::new(&Convolution::same(next, weights, vec![0.0]));
        let mut last = Map::default();
        layer.run(&output, None, false, &mut last);
        assert_equal(&last, &expected, 1e-4 * (inputs * side * side) as f32);
    }

    #[test]
    fn a_folded_normalization_equals_one_after_the_convolution(
        inputs in 1..5_usize, outputs in 1..9_usize, seed: u64,
    ) {
        let shape = [outputs, inputs, 3, 3];
        let weights = random(shape.iter().product(), seed ^ 1);
        let [bias, mean, factors, offsets] = [2, 3, 4, 5].map(|more| random(outputs, seed ^ more));
        let variance: Vec<f32> = random(outputs, seed ^ 6).iter().map(|number| number + 1.1).collect();
        let input = plain(inputs, 5, 9, seed);
        let normalized =
            input.convolve(&shape, &weights, &bias, [1, 1, 1]).normalize(&mean, &variance, 1e-5);
        let expected = Plain::from_fn(outputs, 5, 9, |c, y, x| normalized.get(c, y, x) * factors[c] + offsets[c]);
        let convolution = Convolution::same(shape, weights, bias);
        let layer = Layer::new(&convolution.normalized(&mean, &variance, 1e-5).scaled(&factors, &offsets));
        let mut output = Map::default();
        layer.run(&phases(&input, 1), None, false, &mut output);
        assert_equal(&output, &expected, 1e-4);
    }

    #[test]
    fn resampling_equals_the_loops(channels in 1..5_usize, rows in 1..6_usize, columns in 1..40_usize, seed: u64) {
        let small = plain(channels, rows, columns, seed);
        let map = phases(&small, 1);
        let before = plain(channels, 2 * rows, 2 * columns, seed ^ 1);
        let mut output = phases(&before, 1);
        add_enlarged::<2>(&map, &mut output);
        assert_equal(&output, &before.add(&small.enlarge(2)), 1e-6);
        let mut output = Map::zeros(channels, 16 * rows, 16 * columns);
        add_enlarged::<16>(&map, &mut output);
        assert_equal(&output, &small.enlarge(16), 1e-6);
        let mut squares = Map::default();
        split::<2>(&output, &mut squares);
        assert_equal(&squares, &small.enlarge(16).split(2), 1e-6);
        let large = plain(channels, 4 * rows + 3, 4 * columns + 1, seed ^ 2);
        let (mut halves, mut quarters) = (Map::default(), Map::default());
        average::<2>(&phases(&large, 1), &mut halves);
        assert_equal(&halves, &large.average(2), 1e-6);
        average::<4>(&phases(&large, 1), &mut quarters);
        assert_equal(&quarters, &large.average(4), 1e-6);
    }

    #[test]
    fn a_product_equals_the_sums(inputs in 1..40_usize, blocks in 1..4_usize, count in 0..10_usize, seed: u64) {
        let outputs = 16 * blocks;
        let (rows, bias) = (random(outputs * inputs, seed), random(outputs, seed ^ 1));
        let vectors = random(count * inputs, seed ^ 2);
        let mut products = vec![9.0];
        Matrix::new(&rows, &bias).multiply(&vectors, &mut products);
        prop_assert_eq!(products.len(), count * outputs);
        for (at, product) in products.iter().enumerate() {
            let (vector, output) = (&vectors[at / outputs * inputs..][..inputs], at % outputs);
            let row = &rows[output * inputs..][..inputs];
            let sum: f32 = vector.iter().zip(row).map(|(a, b)| a * b).sum();
            prop_assert!((product - sum - bias[output]).abs() < 1e-5 * inputs as f32);
        }
    }
}

#[test]
fn a_layer_computes_the_same_in_every_run() {
    let shape = [8, 8, 3, 3];
    let layer = Layer::new(&Convolution::same(shape, random(576, 1), random(8, 2)));
    let input = phases(&plain(8, 40, 77, 3), 1);
    let (mut first, mut second) = (Map::default(), Map::zeros(3, 2, 1));
    layer.run(&input, None, true, &mut first);
    layer.run(&input, None, true, &mut second);
    assert_eq!(first, second);
}
