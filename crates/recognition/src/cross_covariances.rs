//! The cross-covariances of a map, by either keyframe.

use map::model::KeyframeCrossCovariance;
use nalgebra::Matrix6;
use protocol::KeyframeId;
use serde::{Deserialize, Serialize};

/// Blocks of the joint covariance, each pair of keyframes once.
#[derive(Default, Serialize, Deserialize)]
pub(crate) struct CrossCovariances {
    /// By (a, b), `a < b`.
    #[serde(deserialize_with = "vision::exact")]
    blocks: Vec<KeyframeCrossCovariance>,
    /// Indices of `blocks` by (b, a).
    #[serde(deserialize_with = "vision::exact")]
    by_second: Vec<u32>,
}

impl CrossCovariances {
    /// # Arguments
    /// * `blocks`: sorted by (a, b), `a < b`.
    pub(crate) fn new(mut blocks: Vec<KeyframeCrossCovariance>) -> CrossCovariances {
        blocks.shrink_to_fit();
        let mut by_second: Vec<u32> = (0..blocks.len() as u32).collect();
        by_second.sort_unstable_by_key(|&at| (blocks[at as usize].b, blocks[at as usize].a));
        CrossCovariances { blocks, by_second }
    }

    pub(crate) fn blocks(&self) -> &[KeyframeCrossCovariance] {
        &self.blocks
    }

    /// Covariance of the errors of two keyframes, rows of `a`; `None` where none is listed.
    pub(crate) fn between(&self, a: KeyframeId, b: KeyframeId) -> Option<Matrix6<f64>> {
        let pair = (a.min(b), a.max(b));
        let at = self.blocks.binary_search_by_key(&pair, |cross| (cross.a, cross.b)).ok()?;
        let block = &self.blocks[at].block;
        Some(if a < b { *block } else { block.transpose() })
    }

    /// What a keyframe is correlated with, by id, and the block, rows of `id`. Costs as much as there is.
    pub(crate) fn of(&self, id: KeyframeId) -> impl Iterator<Item = (KeyframeId, Matrix6<f64>)> {
        let second = |&at: &u32| self.blocks[at as usize].b;
        let smaller = &self.by_second[range_of(&self.by_second, id, second)];
        let larger = &self.blocks[range_of(&self.blocks, id, |cross| cross.a)];
        let smaller = smaller.iter().map(|&at| &self.blocks[at as usize]);
        let transposed = smaller.map(|cross| (cross.a, cross.block.transpose()));
        transposed.chain(larger.iter().map(|cross| (cross.b, cross.block)))
    }
}

/// Where a sorted list has this key.
fn range_of<T>(sorted: &[T], key: u64, key_of: impl Fn(&T) -> u64) -> std::ops::Range<usize> {
    let begin = sorted.partition_point(|item| key_of(item) < key);
    begin..begin + sorted[begin..].partition_point(|item| key_of(item) == key)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_keyframe_has_its_blocks_whichever_comes_first() {
        let block = |value: f64| {
            let mut block = Matrix6::zeros();
            block[(0, 1)] = value;
            block
        };
        let cross = |a, b| KeyframeCrossCovariance { a, b, block: block((10 * a + b) as f64) };
        let all =
            CrossCovariances::new(vec![cross(1, 2), cross(1, 4), cross(2, 3), cross(2, 4), cross(3, 4)]);
        let of = |id| all.of(id).collect::<Vec<_>>();
        let expected = [(1, block(12.0).transpose()), (3, block(23.0)), (4, block(24.0))];
        assert_eq!(of(2), expected);
        assert_eq!(of(4).iter().map(|(other, _)| *other).collect::<Vec<_>>(), [1, 2, 3]);
        assert!(of(0).is_empty() && of(5).is_empty());
        for id in 0..6 {
            assert!(of(id).iter().all(|&(other, block)| all.between(id, other) == Some(block)));
        }
    }
}
