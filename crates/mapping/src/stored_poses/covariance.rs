//! The joint covariance of a map's keyframe poses, as the map states it: `P = U U^T + R` with few columns in `U` and few blocks
//! in `R`, so that products with it cost a multiple of the number of keyframes.

use std::collections::BTreeSet;

use adjustment::POSE;
use map::contents::MapContents;
use map::model::Keyframe;
use nalgebra::{DMatrix, Matrix6};
use protocol::KeyframeId;

/// Lower bounds of the standard deviations (rad, m), so that exact keyframes have a covariance that can be inverted.
const MIN_SIGMAS: [f64; 2] = [1e-6, 1e-5];

/// The covariance of the errors `[δθ, δp]` in G of all keyframes, in the order of the map.
pub(crate) struct MapCovariance {
    /// `U`, 6 rows a keyframe; no columns where the map states no common errors.
    common: DMatrix<f64>,
    /// The blocks of `R` by column, each with its row.
    rest: Vec<Vec<(usize, Matrix6<f64>)>>,
}

impl MapCovariance {
    /// Of a map; `None` where it has entries of keyframes that it lacks.
    pub(crate) fn of_map(contents: &MapContents) -> Option<MapCovariance> {
        let ids: BTreeSet<KeyframeId> = contents.keyframes.iter().map(|keyframe| keyframe.id).collect();
        let has = |id: &KeyframeId| ids.contains(id);
        let cross = &contents.cross_covariances;
        let is_whole = contents.common_errors.iter().all(|entry| has(&entry.keyframe))
            && cross.iter().all(|cross| has(&cross.a) && has(&cross.b));
        Self::of_part(contents, &ids).filter(|_| is_whole)
    }

    /// Of some keyframes of a map; `None` where it lacks one of them.
    pub(crate) fn of_part(contents: &MapContents, part: &BTreeSet<KeyframeId>) -> Option<MapCovariance> {
        let is_of_part = |keyframe: &&Keyframe| part.contains(&keyframe.id);
        let keyframes: Vec<&Keyframe> = contents.keyframes.iter().filter(is_of_part).collect();
        if keyframes.len() != part.len() {
            return None;
        }
        let index_of = |id: u64| keyframes.binary_search_by_key(&id, |keyframe| keyframe.id).ok();
        let columns = contents.common_errors.first().map_or(0, |common| common.factor.ncols());
        let mut common = DMatrix::zeros(POSE * keyframes.len(), columns);
        for entry in &contents.common_errors {
            let Some(at) = index_of(entry.keyframe) else { continue };
            let begin = POSE * at;
            common.fixed_rows_mut::<POSE>(begin).copy_from(&entry.factor);
        }
        let mut rest: Vec<Vec<(usize, Matrix6<f64>)>> = Vec::with_capacity(keyframes.len());
        for (at, keyframe) in keyframes.iter().enumerate() {
            let factor = common.fixed_rows::<POSE>(POSE * at);
            let mut own = keyframe.global_from_keyframe.covariance - factor * factor.transpose();
            for index in 0..POSE {
                own[(index, index)] += MIN_SIGMAS[index / 3].powi(2);
            }
            rest.push(vec![(at, own)]);
        }
        for cross in &contents.cross_covariances {
            let Some((a, b)) = index_of(cross.a).zip(index_of(cross.b)) else { continue };
            rest[b].push((a, cross.block));
            rest[a].push((b, cross.block.transpose()));
        }
        Some(MapCovariance { common, rest })
    }

    /// Number of keyframes.
    pub(super) fn len(&self) -> usize {
        self.rest.len()
    }

    /// The columns of one keyframe, with the rows of all.
    pub(super) fn column(&self, keyframe: usize) -> DMatrix<f64> {
        let factor = self.common.rows(POSE * keyframe, POSE);
        let mut column = &self.common * factor.transpose();
        for (row, block) in &self.rest[keyframe] {
            let mut rows = column.fixed_rows_mut::<POSE>(POSE * row);
            rows += block;
        }
        column
    }

    /// `U`, 6 rows a keyframe.
    pub(crate) fn common(&self) -> &DMatrix<f64> {
        &self.common
    }

    /// The rows and columns of all keyframes.
    pub(crate) fn of_all(&self) -> DMatrix<f64> {
        self.of_keyframes(&(0..self.len()).collect::<Vec<_>>())
    }

    /// The rows and columns of some keyframes.
    pub(crate) fn of_keyframes(&self, keyframes: &[usize]) -> DMatrix<f64> {
        let mut position = vec![None; self.len()];
        for (at, &keyframe) in keyframes.iter().enumerate() {
            position[keyframe] = Some(at);
        }
        let common = rows_of(&self.common, keyframes);
        let mut covariance = &common * common.transpose();
        for (column, &keyframe) in keyframes.iter().enumerate() {
            for (row, block) in &self.rest[keyframe] {
                let Some(row) = position[*row] else { continue };
                let mut entry = covariance.fixed_view_mut::<POSE, POSE>(POSE * row, POSE * column);
                entry += block;
            }
        }
        covariance
    }

    /// The product of the columns of some keyframes with a matrix: `P_:K z`.
    ///
    /// # Arguments
    /// * `wanted`: the keyframes whose rows of the product are needed; those of the others are not defined.
    pub(super) fn times(&self, keyframes: &[usize], z: &DMatrix<f64>, wanted: &[bool]) -> DMatrix<f64> {
        let mut product = &self.common * (rows_of(&self.common, keyframes).transpose() * z);
        for (at, &keyframe) in keyframes.iter().enumerate() {
            let of_keyframe = z.fixed_rows::<POSE>(POSE * at);
            for (row, block) in self.rest[keyframe].iter().filter(|(row, _)| wanted[*row]) {
                let mut rows = product.fixed_rows_mut::<POSE>(POSE * row);
                rows.gemm(1.0, block, &of_keyframe, 1.0);
            }
        }
        product
    }
}

/// A covariance whose variances are the lower bounds at least. What is above them stays as it is.
pub(super) fn bounded(covariance: &Matrix6<f64>) -> Matrix6<f64> {
    let mut bounded = *covariance;
    for index in 0..POSE {
        bounded[(index, index)] = bounded[(index, index)].max(MIN_SIGMAS[index / 3].powi(2));
    }
    bounded
}

/// The 6 rows of each of some keyframes.
pub(super) fn rows_of(matrix: &DMatrix<f64>, keyframes: &[usize]) -> DMatrix<f64> {
    let mut rows = DMatrix::zeros(POSE * keyframes.len(), matrix.ncols());
    for (at, keyframe) in keyframes.iter().enumerate() {
        rows.fixed_rows_mut::<POSE>(POSE * at).copy_from(&matrix.fixed_rows::<POSE>(POSE * keyframe));
    }
    rows
}
