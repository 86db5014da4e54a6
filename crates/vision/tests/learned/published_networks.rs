//! XFeat and R2D2 put together from layers as they were published.

use crate::reference::{Map, Tensors};

/// The names and shapes of XFeat's tensors.
pub fn xfeat_shapes() -> Vec<(String, Vec<usize>)> {
    let blocks: [(&str, &[[usize; 3]]); 8] = [
        ("block1", &[[4, 1, 3], [8, 4, 3], [8, 8, 3], [24, 8, 3]]),
        ("block2", &[[24, 24, 3], [24, 24, 3]]),
        ("block3", &[[64, 24, 3], [64, 64, 3], [64, 64, 1]]),
        ("block4", &[[64, 64, 3], [64, 64, 3], [64, 64, 3]]),
        ("block5", &[[128, 64, 3], [128, 128, 3], [128, 128, 3], [64, 128, 1]]),
        ("block_fusion", &[[64, 64, 3], [64, 64, 3]]),
        ("heatmap_head", &[[64, 64, 1], [64, 64, 1]]),
        ("keypoint_head", &[[64, 64, 1], [64, 64, 1], [64, 64, 1]]),
    ];
    let mut shapes = vec![("skip1.1.weight".into(), vec![24, 1, 1, 1]), ("skip1.1.bias".into(), vec![24])];
    for (block, layers) in blocks {
        for (index, &[outputs, inputs, side]) in layers.iter().enumerate() {
            let layer = format!("{block}.{index}.layer");
            shapes.push((format!("{layer}.0.weight"), vec![outputs, inputs, side, side]));
            shapes.push((format!("{layer}.1.running_mean"), vec![outputs]));
            shapes.push((format!("{layer}.1.running_var"), vec![outputs]));
        }
    }
    for (name, outputs) in [("block_fusion.2", 64), ("heatmap_head.2", 1), ("keypoint_head.3", 65)] {
        shapes.push((format!("{name}.weight"), vec![outputs, 64, 1, 1]));
        shapes.push((format!("{name}.bias"), vec![outputs]));
    }
    shapes
}

/// Descriptors, keypoint logits and reliability.
pub fn xfeat(tensors: &Tensors, image: &Map) -> [Map; 3] {
    let layer = |map: &Map, name: &str, stride: usize| {
        let (shape, weights) = &tensors[&format!("{name}.layer.0.weight")];
        let sum = map.convolve(shape, weights, &vec![0.0; shape[0]], [stride, shape[3] / 2, 1]);
        let mean = &tensors[&format!("{name}.layer.1.running_mean")].1;
        let variance = &tensors[&format!("{name}.layer.1.running_var")].1;
        sum.normalize(mean, variance, 1e-5).map(|number| number.max(0.0))
    };
    let block = |map: &Map, name: &str, strides: &[usize]| {
        strides
            .iter()
            .enumerate()
            .fold(map.clone(), |map, (i, &stride)| layer(&map, &format!("{name}.{i}"), stride))
    };
    let plain = |map: &Map, name: &str| {
        let (shape, weights) = &tensors[&format!("{name}.weight")];
        map.convolve(shape, weights, &tensors[&format!("{name}.bias")].1, [1, 0, 1])
    };
    let x1 = block(image, "block1", &[1, 2, 1, 2]);
    let x2 = block(&x1.add(&plain(&image.average(4), "skip1.1")), "block2", &[1, 1]);
    let x3 = block(&x2, "block3", &[2, 1, 1]);
    let x4 = block(&x3, "block4", &[2, 1, 1]);
    let x5 = block(&x4, "block5", &[2, 1, 1, 1]);
    let pyramid = x3.add(&x4.enlarge(2)).add(&x5.enlarge(4));
    let descriptors = plain(&block(&pyramid, "block_fusion", &[1, 1]), "block_fusion.2");
    let reliability = plain(&block(&descriptors, "heatmap_head", &[1, 1]), "heatmap_head.2");
    let keypoints = plain(&block(&image.split(8), "keypoint_head", &[1, 1, 1]), "keypoint_head.3");
    [descriptors, keypoints, reliability.map(|number| 1.0 / (1.0 + (-number).exp()))]
}

/// Of R2D2's layers: position, inputs, outputs, kernel size, dilation.
pub const R2D2_LAYERS: [[usize; 5]; 9] = [
    [0, 3, 32, 3, 1],
    [3, 32, 32, 3, 1],
    [6, 32, 64, 3, 1],
    [9, 64, 64, 3, 2],
    [12, 64, 128, 3, 2],
    [15, 128, 128, 3, 4],
    [18, 128, 128, 2, 4],
    [20, 128, 128, 2, 8],
    [22, 128, 128, 2, 16],
];

/// The names and shapes of R2D2's tensors.
pub fn r2d2_shapes() -> Vec<(String, Vec<usize>)> {
    let mut shapes = Vec::new();
    let last = [("clf".to_owned(), 2, 128, 1), ("sal".to_owned(), 1, 128, 1)];
    let layers =
        R2D2_LAYERS.map(|[at, inputs, outputs, side, _]| (format!("ops.{at}"), outputs, inputs, side));
    for (name, outputs, inputs, side) in layers.into_iter().chain(last) {
        shapes.push((format!("{name}.weight"), vec![outputs, inputs, side, side]));
        shapes.push((format!("{name}.bias"), vec![outputs]));
    }
    for [at, _, outputs, ..] in &R2D2_LAYERS[..8] {
        for what in ["mean", "var"] {
            shapes.push((format!("ops.{}.running_{what}", at + 1), vec![*outputs]));
        }
    }
    shapes
}

/// Descriptors (of any length); reliability and repeatability.
pub fn r2d2(tensors: &Tensors, image: &Map) -> [Map; 3] {
    let convolve = |map: &Map, name: &str, dilation: usize| {
        let (shape, weights) = &tensors[&format!("{name}.weight")];
        let padding = (shape[2] - 1) * dilation / 2;
        map.convolve(shape, weights, &tensors[&format!("{name}.bias")].1, [1, padding, dilation])
    };
    let mut x = image.clone();
    for (number, [at, .., dilation]) in R2D2_LAYERS.into_iter().enumerate() {
        x = convolve(&x, &format!("ops.{at}"), dilation);
        if number < 8 {
            let of = |what: &str| &tensors[&format!("ops.{}.running_{what}", at + 1)].1;
            x = x.normalize(of("mean"), of("var"), 1e-5);
        }
        if number < 6 {
            x = x.map(|number| number.max(0.0));
        }
    }
    let squares = x.map(|number| number * number);
    let (reliable, repeatable) = (convolve(&squares, "clf", 1), convolve(&squares, "sal", 1));
    let reliability = Map::from_fn(1, x.rows, x.columns, |_, row, column| {
        let [no, yes] = [0, 1].map(|channel| reliable.get(channel, row, column).exp());
        yes / (no + yes)
    });
    let softplus = repeatable.map(|number| (1.0 + number.exp()).ln());
    [x, reliability, softplus.map(|number| number / (1.0 + number))]
}
