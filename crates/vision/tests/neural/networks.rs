//! A network that the program writes and an engine runs gives the numbers of a direct computation.

use super::reference::{Map, xfeat};
use super::{engines, random_xfeat, state};
use vision::features::Tensor;
use vision::features::neural::graph::{Convolution, Graph};
use vision::features::neural::{Network, NetworkError, write_xfeat};

fn wave(c: usize, y: usize, x: usize) -> f32 {
    ((c * 131 + y * 37 + x * 17) as f32 * 0.61).sin()
}

/// Largest difference, as a part of the largest number.
fn difference(found: &Tensor, expected: &Map) -> f32 {
    assert_eq!(found.shape, [1, expected.channels, expected.rows, expected.columns]);
    let largest = expected.data.iter().fold(0.0_f32, |largest, number| largest.max(number.abs()));
    let pairs = found.data.iter().zip(&expected.data);
    pairs.fold(0.0_f32, |worst, (a, b)| worst.max((a - b).abs())) / largest
}

fn convolution(shape: [usize; 4], stride: usize, padding: usize) -> Convolution {
    let weights = (0..shape.iter().product()).map(|i| wave(i, 3, 5)).collect();
    let bias = (0..shape[0]).map(|i| wave(i, 7, 1)).collect();
    Convolution { shape, weights, bias, stride, padding }
}

#[test]
fn every_operator_does_what_it_says() {
    let image = Map::from_fn(2, 12, 20, wave);
    let apply = |map: &Map, c: &Convolution| map.convolve(&c.shape, &c.weights, &c.bias, c.stride, c.padding);
    let first = convolution([5, 2, 3, 3], 2, 1);
    let second = convolution([5, 5, 1, 1], 1, 0);
    let (mean, variance) = ([0.2, -0.4, 0.1, 0.0, 0.3], [0.5, 2.0, 0.1, 1.0, 0.7]);

    let mut graph = Graph::default();
    graph.input("image", 2);
    graph.convolve("image", "plain", &first);
    graph.convolve("image", "normalized", &first.clone().normalized(&mean, &variance, 1e-5));
    graph.relu("normalized", "relu");
    graph.convolve("relu", "second", &second);
    graph.add("plain", "second", "sum");
    graph.upsample("sum", "large", 4);
    graph.sigmoid("large", "sigmoid");
    let names = ["plain", "normalized", "relu", "sum", "large", "sigmoid"];
    for name in names {
        graph.output(name, 5);
    }
    let onnx = graph.write();

    let plain = apply(&image, &first);
    let normalized = plain.normalize(&mean, &variance, 1e-5);
    let relu = normalized.map(|number| number.max(0.0));
    let sum = plain.add(&apply(&relu, &second));
    let large = sum.enlarge(4);
    let sigmoid = large.map(|number| 1.0 / (1.0 + (-number).exp()));
    let expected = [plain, normalized, relu, sum, large, sigmoid];
    for engine in engines() {
        let mut network = Network::load(onnx.clone(), "image", &names, engine).unwrap();
        let found = network.run([1, 2, 12, 20], image.data.clone()).unwrap();
        for ((name, found), expected) in names.iter().zip(&found).zip(&expected) {
            assert!(difference(found, expected) < 1e-5, "{name} in {engine:?}");
        }
    }
}

#[test]
fn xfeat_is_the_published_network() {
    let tensors = random_xfeat(3);
    let onnx = write_xfeat(&state(&tensors)).unwrap();
    let image = Map::from_fn(1, 64, 96, wave);
    let expected = xfeat(&tensors, &image);
    for engine in engines() {
        let names = ["descriptors", "keypoints", "reliability"];
        let mut network = Network::load(onnx.clone(), "image", &names, engine).unwrap();
        let found = network.run([1, 1, 64, 96], image.data.clone()).unwrap();
        for ((name, found), expected) in names.iter().zip(&found).zip(&expected) {
            let difference = difference(found, expected);
            assert!(difference < 1e-4, "{name} in {engine:?}: {difference}");
        }
    }
}

#[test]
fn wrong_names_inputs_and_numbers_are_errors() {
    let mut graph = Graph::default();
    graph.input("image", 1);
    graph.convolve("image", "out", &convolution([1, 1, 3, 3], 1, 0));
    graph.output("out", 1);
    let onnx = graph.write();
    for engine in engines() {
        let load = |input: &str, output: &str| Network::load(onnx.clone(), input, &[output], engine);
        for (input, output) in [("picture", "out"), ("image", "in")] {
            assert!(
                matches!(load(input, output), Err(NetworkError::Tensor(_))),
                "{input} {output} {engine:?}"
            );
        }
        let mut network = load("image", "out").unwrap();
        assert!(matches!(network.run([1, 3, 8, 8], vec![0.0; 192]), Err(NetworkError::Run(_))));
        assert!(matches!(network.run([1, 1, 8, 8], vec![0.0; 63]), Err(NetworkError::Run(_))));
        let infinite = network.run([1, 1, 8, 8], vec![f32::INFINITY; 64]);
        assert!(matches!(infinite, Err(NetworkError::NotFinite(_))), "{engine:?}");
    }
}
