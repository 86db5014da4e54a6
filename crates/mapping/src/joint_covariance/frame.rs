//! The frame of a map without reference poses: that in which its keyframes as a whole are where they are stated to be.
//!
//! Nothing measures yaw and origin of such a map. The adjustment holds its first keyframe, and states how far the others may be off
//! as seen from it: nothing near the first one, centimetres at the other end. Who compares the map with a truth, and who uses
//! places in it, takes it as a whole. The S-transformation states the errors so:
//! ```text
//! e' = (I - A M) e          M e: yaw and translation that align the erroneous positions with the true ones best
//! P' = (I - A M) P (I - A M)^T + A G A^T + sigma_s^2 s s^T
//! ```
//! with `A` the errors that a yaw about the centre, and a translation, of the map are, `G` the small covariance of the definition,
//! and `s` the errors of a map whose scale is off by one: its positions relative to the centre. `sigma_s` is added to what the adjustment
//! states of the scale, see `scale`.
//!
//! Source: Baarda, "S-transformations and criterion matrices", 1973.

use adjustment::parallel;
use map::model::{GAUGE_SIGMA_P, GAUGE_SIGMA_YAW};
use nalgebra::{Matrix4, Matrix6, SMatrix, Vector3, Vector4};

use super::scale::SCALE_SIGMA;

type Shift = SMatrix<f64, 6, 4>;
type Alignment = SMatrix<f64, 4, 6>;

/// Least mean distance of the keyframes from their centre, m: nearer ones show the yaw by their rotations.
const LEAST_RADIUS_M: f64 = 0.1;

/// Blocks of `P`, column by column, relative to the map as a whole.
pub(super) struct WholeMapFrame<F> {
    column: F,
    /// `A` of each pose.
    shifts: Vec<Shift>,
    /// `M P_:j` of each pose.
    aligned: Vec<Alignment>,
    /// `M P M^T + G`.
    own: Matrix4<f64>,
    /// `sigma_s s` of each pose (m): errors of its position.
    scaled: Vec<Vector3<f64>>,
}

impl<F: Fn(usize) -> Vec<Matrix6<f64>> + Sync> WholeMapFrame<F> {
    /// # Arguments
    /// * `positions`: of the poses (m).
    /// * `gravity`: unit vector.
    /// * `column`: `P_:j`, a block for each pose.
    pub(super) fn new(positions: &[Vector3<f64>], gravity: &Vector3<f64>, column: F) -> Self {
        let centre = positions.iter().sum::<Vector3<f64>>() / positions.len().max(1) as f64;
        let moved_by_yaw = |position: &Vector3<f64>| gravity.cross(&(position - centre));
        let shifts: Vec<Shift> = positions
            .iter()
            .map(|position| {
                let mut shift = Shift::zeros();
                shift.fixed_view_mut::<3, 1>(0, 0).copy_from(gravity);
                shift.fixed_view_mut::<3, 1>(3, 0).copy_from(&moved_by_yaw(position));
                shift.fixed_view_mut::<3, 3>(3, 1).fill_with_identity();
                shift
            })
            .collect();
        let alignments = alignments(&shifts);
        let mut aligned = Vec::with_capacity(shifts.len());
        let mut own = gauge_covariance();
        parallel::for_each(shifts.len(), &column, |blocks| {
            let sum: Alignment =
                alignments.iter().zip(&blocks).map(|(alignment, block)| alignment * block).sum();
            own += sum * alignments[aligned.len()].transpose();
            aligned.push(sum);
        });
        let scaled = positions.iter().map(|position| SCALE_SIGMA * (position - centre)).collect();
        Self { column, shifts, aligned, own, scaled }
    }

    /// `P'_:j`, a block for each pose.
    pub(super) fn column(&self, j: usize) -> Vec<Matrix6<f64>> {
        let of_column = &self.aligned[j];
        let rest = self.own * self.shifts[j].transpose() - of_column;
        let rows = self.shifts.iter().zip(&self.aligned).zip(&self.scaled);
        (self.column)(j)
            .iter()
            .zip(rows)
            .map(|(block, ((shift, of_row), scaled))| {
                let mut block = block + shift * rest - of_row.transpose() * self.shifts[j].transpose();
                let mut positions = block.fixed_view_mut::<3, 3>(3, 3);
                positions += scaled * self.scaled[j].transpose();
                block
            })
            .collect()
    }
}

/// `M` of each pose: least squares of the positions, with the rotations as if by points at [`LEAST_RADIUS_M`].
fn alignments(shifts: &[Shift]) -> Vec<Alignment> {
    let weight = |shift: &Shift| {
        let mut weighted = shift.transpose();
        weighted.fixed_columns_mut::<3>(0).scale_mut(LEAST_RADIUS_M * LEAST_RADIUS_M);
        weighted
    };
    let normal: Matrix4<f64> = shifts.iter().map(|shift| weight(shift) * shift).sum();
    let inverse = normal.try_inverse().unwrap_or_else(Matrix4::zeros);
    shifts.iter().map(|shift| inverse * weight(shift)).collect()
}

/// `G`.
fn gauge_covariance() -> Matrix4<f64> {
    let [yaw, position] = [GAUGE_SIGMA_YAW, GAUGE_SIGMA_P].map(|sigma| sigma * sigma);
    Matrix4::from_diagonal(&Vector4::new(yaw, position, position, position))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;

    const COUNT: usize = 7;

    /// Positions, and a covariance of all poses.
    fn poses() -> (Vec<Vector3<f64>>, DMatrix<f64>) {
        let at =
            |k: usize| Vector3::new(3.0 * k as f64, (1.7 * k as f64).sin() * 5.0, (0.9 * k as f64).cos());
        let root = DMatrix::from_fn(6 * COUNT, 6 * COUNT, |i, j| ((3 * i + 5 * j + i * j) as f64).sin());
        ((0..COUNT).map(at).collect(), &root * root.transpose() * 1e-4)
    }

    fn transformed(positions: &[Vector3<f64>], covariance: &DMatrix<f64>) -> DMatrix<f64> {
        let column = |j: usize| -> Vec<Matrix6<f64>> {
            (0..COUNT).map(|i| covariance.fixed_view::<6, 6>(6 * i, 6 * j).into_owned()).collect()
        };
        let frame = WholeMapFrame::new(positions, &-Vector3::z(), column);
        let mut found = DMatrix::zeros(6 * COUNT, 6 * COUNT);
        for j in 0..COUNT {
            for (i, block) in frame.column(j).iter().enumerate() {
                found.fixed_view_mut::<6, 6>(6 * i, 6 * j).copy_from(block);
            }
        }
        found
    }

    /// `A` and `M` of all poses.
    fn gauge(positions: &[Vector3<f64>]) -> (DMatrix<f64>, DMatrix<f64>) {
        let frame = WholeMapFrame::new(positions, &-Vector3::z(), |_| vec![Matrix6::zeros(); COUNT]);
        let mut shifts = DMatrix::zeros(6 * COUNT, 4);
        let mut alignment = DMatrix::zeros(4, 6 * COUNT);
        for (k, (shift, of_pose)) in frame.shifts.iter().zip(alignments(&frame.shifts)).enumerate() {
            shifts.fixed_rows_mut::<6>(6 * k).copy_from(shift);
            alignment.fixed_columns_mut::<6>(6 * k).copy_from(&of_pose);
        }
        (shifts, alignment)
    }

    #[test]
    fn the_blocks_are_those_of_the_dense_transformation() {
        let (positions, covariance) = poses();
        let (shifts, alignment) = gauge(&positions);
        assert!((&alignment * &shifts - DMatrix::identity(4, 4)).amax() < 1e-12);
        let project = DMatrix::identity(6 * COUNT, 6 * COUNT) - &shifts * &alignment;
        let definition = DMatrix::from_column_slice(4, 4, gauge_covariance().as_slice());
        let expected =
            &project * &covariance * project.transpose() + &shifts * definition * shifts.transpose();
        // A map that is larger than the place by a share has these errors, and is aligned as it is.
        let centre = positions.iter().sum::<Vector3<f64>>() / COUNT as f64;
        let scale = DMatrix::from_fn(6 * COUNT, 1, |row, _| match row % 6 {
            ..3 => 0.0,
            axis => (positions[row / 6] - centre)[axis - 3],
        });
        assert!((&alignment * &scale).amax() < 1e-12 * scale.amax());
        let expected = expected + SCALE_SIGMA * SCALE_SIGMA * &scale * scale.transpose();
        let found = transformed(&positions, &covariance);
        assert!((&found - &expected).amax() < 1e-12 * expected.amax());
        assert!((&found - found.transpose()).amax() < 1e-12 * expected.amax());
    }

    #[test]
    fn it_does_not_matter_which_keyframe_was_held() {
        let (positions, covariance) = poses();
        let (shifts, _) = gauge(&positions);
        // The same errors, seen from a frame that is off by any yaw and translation.
        let common = DMatrix::from_fn(4, 6 * COUNT, |i, j| ((i + 2 * j) as f64).cos());
        let moved = DMatrix::identity(6 * COUNT, 6 * COUNT) + &shifts * common;
        let other = &moved * &covariance * moved.transpose();
        let (one, two) = (transformed(&positions, &covariance), transformed(&positions, &other));
        assert!((&one - two).amax() < 1e-9 * one.amax());
    }
}
