//! The networks give the numbers of a direct computation.

use super::published_networks::{r2d2, r2d2_shapes, xfeat, xfeat_shapes};
use super::{random_tensors, state};
use crate::reference::Map as Plain;
use vision::features::layers::Map;
use vision::features::r2d2::R2d2Network;
use vision::features::xfeat::XfeatNetwork;
use vision::features::{StateDict, StateDictError};

fn wave(c: usize, y: usize, x: usize) -> f32 {
    ((c * 131 + y * 37 + x * 17) as f32 * 0.61).sin()
}

/// The same numbers.
pub fn map(plain: &Plain) -> Map {
    let mut map = Map::zeros(plain.channels, plain.rows, plain.columns);
    for channel in 0..plain.channels {
        for y in 0..plain.rows {
            for (x, number) in map.row_mut(channel, y).iter_mut().enumerate() {
                *number = plain.get(channel, y, x);
            }
        }
    }
    map
}

/// Largest difference of a channel from all channels of another map, as a part of the largest number.
pub fn difference(found: &Map, first: usize, expected: &Plain) -> f32 {
    assert_eq!([found.rows(), found.columns()], [expected.rows, expected.columns]);
    let largest = expected.data.iter().fold(0.0_f32, |largest, number| largest.max(number.abs()));
    let mut worst = 0.0_f32;
    for channel in 0..expected.channels {
        for y in 0..expected.rows {
            for (x, number) in found.row(first + channel, y).iter().enumerate() {
                worst = worst.max((number - expected.get(channel, y, x)).abs());
            }
        }
    }
    worst / largest
}

#[test]
fn xfeat_is_the_published_network() {
    let tensors = random_tensors(xfeat_shapes(), 3);
    let mut network = XfeatNetwork::new(&state(&tensors)).unwrap();
    for (rows, columns) in [(64, 96), (32, 160), (64, 96)] {
        let image = Plain::from_fn(1, rows, columns, wave);
        let expected = xfeat(&tensors, &image);
        for (found, expected) in network.run(&map(&image)).into_iter().zip(&expected) {
            assert_eq!(found.channels(), expected.channels);
            assert!(difference(found, 0, expected) < 1e-4);
        }
    }
}

#[test]
fn r2d2_is_the_published_network() {
    let tensors = random_tensors(r2d2_shapes(), 4);
    let mut network = R2d2Network::new(&state(&tensors)).unwrap();
    for (rows, columns) in [(7, 11), (19, 3), (7, 11)] {
        let image = Plain::from_fn(3, rows, columns, wave);
        let [descriptors, reliability, repeatability] = r2d2(&tensors, &image);
        let [found, confidences] = network.run(&map(&image));
        assert_eq!(found.channels(), 128);
        assert!(difference(found, 0, &descriptors) < 1e-4);
        assert!(difference(confidences, 0, &reliability) < 1e-4);
        assert!(difference(confidences, 1, &repeatability) < 1e-4);
    }
}

type Read = fn(&StateDict) -> Result<(), StateDictError>;

#[test]
fn a_network_needs_every_tensor_in_its_shape_and_finite() {
    let networks: [(_, Read); 2] = [
        (xfeat_shapes(), |state| XfeatNetwork::new(state).map(|_| ())),
        (r2d2_shapes(), |state| R2d2Network::new(state).map(|_| ())),
    ];
    for (shapes, read) in networks {
        let tensors = random_tensors(shapes, 1);
        assert!(read(&state(&tensors)).is_ok());
        for name in tensors.keys() {
            let mut missing = tensors.clone();
            missing.remove(name);
            assert!(matches!(read(&state(&missing)), Err(StateDictError::Missing(what)) if what == *name));
            let mut wrong = tensors.clone();
            wrong.get_mut(name).unwrap().0.insert(0, 1);
            assert!(
                matches!(read(&state(&wrong)), Err(StateDictError::Shape { name: what, .. }) if what == *name)
            );
            let mut infinite = tensors.clone();
            infinite.get_mut(name).unwrap().1[0] = f32::NAN;
            assert!(matches!(read(&state(&infinite)), Err(StateDictError::NotFinite(what)) if what == *name));
        }
        let mut negative = tensors.clone();
        let name = tensors.keys().find(|name| name.ends_with("running_var")).unwrap();
        negative.get_mut(name).unwrap().1[3] = -1.0;
        assert!(matches!(read(&state(&negative)), Err(StateDictError::NotFinite(what)) if what == *name));
    }
}
