//! Halls beside each other that were mapped like one, with descriptors of their own.

use std::collections::BTreeMap;

use map::{CommonError, KeyframeAliases, KeyframeCrossCovariance, MapContents};
use nalgebra::{Matrix6, Matrix6xX, Vector3};
use protocol::KeyframeId;
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};

/// From a hall to the next one (m).
const APART_M: f64 = 300.0;

/// A map of so many halls, the first of which is the given one, sorted; ids of keyframes and of landmarks ascend from hall to hall.
///
/// The errors of different halls are independent.
pub(super) fn halls(hall: &MapContents, count: u64) -> MapContents {
    copies(hall, count, false)
}

/// The same with the same descriptors in all halls.
pub(super) fn alike_halls(hall: &MapContents, count: u64) -> MapContents {
    copies(hall, count, true)
}

fn copies(hall: &MapContents, count: u64, alike: bool) -> MapContents {
    let keyframe_ids = 1 + hall.keyframes.iter().map(|keyframe| keyframe.id).max().unwrap();
    let landmark_ids = 1 + hall.landmarks.iter().map(|landmark| landmark.id).max().unwrap();
    let mut map = MapContents::empty(hall.info.clone());
    for copy in 0..count {
        let mut rng = StdRng::seed_from_u64(copy);
        let (keyframe_id, landmark_id) = (copy * keyframe_ids, copy * landmark_ids);
        for of_hall in &hall.keyframes {
            let mut keyframe = of_hall.clone();
            keyframe.id += keyframe_id;
            keyframe.stamp_ns += copy as i64;
            keyframe.global_from_keyframe.pose.translation += Vector3::x() * (copy as f64 * APART_M);
            map.aliases.push(KeyframeAliases { keyframe: keyframe.id, places: Vec::new() });
            map.keyframes.push(keyframe);
        }
        for of_hall in &hall.landmarks {
            let mut landmark = of_hall.clone().with_higher_ids(keyframe_id, landmark_id);
            let other: Vec<u8> = (0..32).map(|_| if copy == 0 || alike { 0 } else { rng.random() }).collect();
            for seen in &mut landmark.observations {
                seen.descriptor.iter_mut().zip(&other).for_each(|(byte, other)| *byte ^= other);
            }
            map.landmarks.push(landmark);
        }
        for of_hall in &hall.cross_covariances {
            let mut cross = of_hall.clone();
            cross.a += keyframe_id;
            cross.b += keyframe_id;
            map.cross_covariances.push(cross);
        }
    }
    map.info.sessions.clear();
    map.ensure_sessions("halls");
    map.sort();
    map
}

/// Columns of the errors that all keyframes have in common.
const COLUMNS: usize = 18;
/// Standard deviation of these along an axis (rad, m).
const SIGMA_COMMON: f64 = 1e-3;

/// Adds errors that all keyframes of a map have in common, nearly the same for neighbours.
///
/// # Arguments
/// * `listed`: stated by the cross-covariances of all pairs, not as common errors.
pub(super) fn add_drift(map: &mut MapContents, listed: bool) {
    let factor = |at: usize| {
        let column = |row: usize, column: usize| {
            (0.02 * (at * (1 + column / 6)) as f64 + (row * 7 + column) as f64).sin()
        };
        Matrix6xX::from_fn(COLUMNS, |row, of| column(row, of) * SIGMA_COMMON / (COLUMNS as f64).sqrt())
    };
    let factors: Vec<Matrix6xX<f64>> = (0..map.keyframes.len()).map(factor).collect();
    for (keyframe, factor) in map.keyframes.iter_mut().zip(&factors) {
        keyframe.global_from_keyframe.covariance += factor * factor.transpose();
    }
    let ids: Vec<KeyframeId> = map.keyframes.iter().map(|keyframe| keyframe.id).collect();
    if !listed {
        let common = ids.into_iter().zip(factors);
        map.common_errors = common.map(|(keyframe, factor)| CommonError { keyframe, factor }).collect();
        return;
    }
    let mut blocks: BTreeMap<(KeyframeId, KeyframeId), Matrix6<f64>> = BTreeMap::new();
    for (b, of_b) in factors.iter().enumerate() {
        blocks.extend(
            factors[..b].iter().enumerate().map(|(a, of_a)| ((ids[a], ids[b]), of_a * of_b.transpose())),
        );
    }
    for cross in &map.cross_covariances {
        if let Some(block) = blocks.get_mut(&(cross.a, cross.b)) {
            *block += cross.block;
        }
    }
    let pairs = blocks.into_iter();
    map.cross_covariances = pairs.map(|((a, b), block)| KeyframeCrossCovariance { a, b, block }).collect();
    map.sort();
}
