//! The linearized measurement of one pixel: two whitened rows over the calibration of its camera, its clone, with a rolling
//! shutter the clone beside it, and the landmark.

use crate::calibration::{CAMERA_DIM, CameraJacobian};
use crate::linear_algebra::dense::Dense;
use crate::measurement::Information;
use crate::rolling_shutter::row_pose::{Estimates, RowPose};
use crate::state::{ActiveState, Block, CloneId, POSE_DIM};
use nalgebra::{DVector, Matrix2, Matrix2x3, Matrix2x6, Vector2, Vector3};
use smallvec::SmallVec;
use std::ops::Range;

/// The linearized measurement of one pixel, whitened.
#[derive(Clone, Debug)]
pub struct PixelMeasurement {
    /// Index of the camera.
    pub camera: usize,
    /// Index of the clone.
    pub clone_index: usize,
    /// With respect to the error of the clone.
    pub wrt_clone: Matrix2x6<f64>,
    /// Index of the clone beside it that the row's pose depends on, and with respect to its error; `None` with a global shutter.
    pub neighbour: Option<(usize, Matrix2x6<f64>)>,
    /// With respect to the position of the landmark in L.
    pub wrt_landmark: Matrix2x3<f64>,
    /// With respect to the error of the camera; only the columns that are estimated are used.
    pub wrt_camera: CameraJacobian,
    /// Measured minus predicted.
    pub residual: Vector2<f64>,
}

/// The state blocks of the odometry's measurements within the active error: calibration, then clones.
#[derive(Clone, Debug, PartialEq)]
pub struct Layout {
    /// Range of the calibration.
    pub calibration: Range<usize>,
    /// Range of the clones.
    pub clones: Range<usize>,
}

impl Layout {
    /// The layout of a state.
    pub fn of(state: &ActiveState) -> Self {
        let calibration = state.range(Block::Calibration).unwrap_or(0..0);
        Self { calibration, clones: state.clones_begin()..state.dim() }
    }

    /// Both ranges, without empty ones.
    pub fn runs(&self) -> impl Iterator<Item = Range<usize>> {
        [self.calibration.clone(), self.clones.clone()].into_iter().filter(|run| !run.is_empty())
    }

    /// First column of a clone.
    pub(crate) fn clone_column(&self, index: usize) -> usize {
        self.calibration.len() + POSE_DIM * index
    }

    /// Number of columns.
    pub(crate) fn len(&self) -> usize {
        self.calibration.len() + self.clones.len()
    }
}

/// Linearizes the measurement of a pixel; `None` where the landmark does not project.
///
/// # Arguments
/// * `observed`: clone, index of the camera, measured pixel.
/// * `landmark`: newest estimate in L, metres.
/// * `first`: first estimate of the landmark. If given, Jacobians are evaluated there and at the clone's first estimate,
///   else at the newest estimates.
/// * `sigma_px`: noise of the pixel, px.
pub fn linearize_pixel(
    state: &ActiveState,
    observed: (CloneId, usize, Vector2<f64>),
    landmark: &Vector3<f64>,
    first: Option<&Vector3<f64>>,
    sigma_px: f64,
) -> Option<PixelMeasurement> {
    let (clone, camera, pixel) = observed;
    let index = state.clone_index(clone)?;
    let calibrated = state.calibration.cameras.get(camera)?;
    let row_at = |estimates| RowPose::of(state, index, camera, &pixel, estimates);
    let (row, projection, predicted) = if let Some(first) = first {
        let row = row_at(Estimates::First);
        (
            row,
            calibrated.predict_with_jacobians(&row.local_from_imu, first)?,
            calibrated.predict(&row_at(Estimates::Newest).local_from_imu, landmark)?,
        )
    } else {
        let row = row_at(Estimates::Newest);
        let projection = calibrated.predict_with_jacobians(&row.local_from_imu, landmark)?;
        (row, projection, projection.pixel)
    };
    let whiten = 1.0 / sigma_px;
    let mut wrt_camera = if state.calibration.dim() > 0 {
        state.calibration.camera_jacobian(camera, &projection) * whiten
    } else {
        CameraJacobian::zeros()
    };
    let wrt_row = projection.wrt_body * whiten;
    let (mut wrt_clone, mut neighbour) = (wrt_row, None);
    if let Some(dependence) = &row.dependence {
        wrt_clone = dependence.own.chain(&wrt_row);
        neighbour = dependence.neighbour.map(|(index, part)| (index, part.chain(&wrt_row)));
        if let Some(readout) = state.calibration.readout_index(camera) {
            let column = readout - state.calibration.camera_range(camera).start;
            wrt_camera.set_column(column, &(wrt_row * dependence.by_readout));
        }
    }
    Some(PixelMeasurement {
        camera,
        clone_index: index,
        wrt_clone,
        neighbour,
        wrt_landmark: projection.wrt_landmark * whiten,
        wrt_camera,
        residual: (pixel - predicted) * whiten,
    })
}

/// Two rows over consecutive columns of the active error.
#[derive(Clone, Copy, Debug)]
pub struct JacobianBlock {
    begin: usize,
    width: usize,
    /// Column by column, two values each.
    values: [f64; 2 * CAMERA_DIM],
}

impl JacobianBlock {
    /// The first `width` columns of a Jacobian in column-major order.
    pub fn new(begin: usize, width: usize, jacobian: &[f64]) -> Self {
        let mut values = [0.0; 2 * CAMERA_DIM];
        values[..2 * width].copy_from_slice(&jacobian[..2 * width]);
        Self { begin, width, values }
    }
}

/// The non-zero blocks of two rows.
pub type JacobianBlocks = SmallVec<[JacobianBlock; 3]>;

impl PixelMeasurement {
    /// The linearized change of the pixel by an error of the active state, with the landmark where it is.
    pub fn change(&self, state: &ActiveState, layout: &Layout, error: &DVector<f64>) -> Vector2<f64> {
        let of_clone = |index: usize| error.fixed_rows::<POSE_DIM>(layout.clones.start + POSE_DIM * index);
        let mut change = self.wrt_clone * of_clone(self.clone_index);
        if let Some((index, wrt_neighbour)) = &self.neighbour {
            change += wrt_neighbour * of_clone(*index);
        }
        if !layout.calibration.is_empty() {
            let range = state.calibration.camera_range(self.camera);
            let own = error.rows(layout.calibration.start + range.start, range.len());
            change += self.wrt_camera.columns(0, range.len()) * own;
        }
        change
    }

    /// Indices of the first and the last clone that it depends on.
    pub(crate) fn clone_span(&self) -> (usize, usize) {
        let other = self.neighbour.as_ref().map_or(self.clone_index, |(index, _)| *index);
        (self.clone_index.min(other), self.clone_index.max(other))
    }

    /// Its non-zero blocks in the active error, without the landmark.
    pub fn blocks(&self, state: &ActiveState, layout: &Layout) -> JacobianBlocks {
        let mut blocks = JacobianBlocks::new();
        let begin = |index: usize| layout.clones.start + POSE_DIM * index;
        blocks.push(JacobianBlock::new(begin(self.clone_index), POSE_DIM, self.wrt_clone.as_slice()));
        if let Some((index, wrt_neighbour)) = &self.neighbour {
            blocks.push(JacobianBlock::new(begin(*index), POSE_DIM, wrt_neighbour.as_slice()));
        }
        if !layout.calibration.is_empty() {
            let range = state.calibration.camera_range(self.camera);
            let begin = layout.calibration.start + range.start;
            blocks.push(JacobianBlock::new(begin, range.len(), self.wrt_camera.as_slice()));
        }
        blocks
    }
}

/// `H_i P H_jᵀ` of two pixels.
pub fn covariance_between(
    covariance: &Dense,
    first: &[JacobianBlock],
    second: &[JacobianBlock],
) -> Matrix2<f64> {
    let mut product = Matrix2::zeros();
    for left in first {
        for right in second {
            for (j, weights) in right.values[..2 * right.width].chunks_exact(2).enumerate() {
                let numbers = &covariance.column(right.begin + j)[left.begin..left.begin + left.width];
                let (mut upper, mut lower) = (0.0, 0.0);
                for (number, pair) in numbers.iter().zip(left.values.chunks_exact(2)) {
                    upper += pair[0] * number;
                    lower += pair[1] * number;
                }
                product += Matrix2::new(
                    upper * weights[0],
                    upper * weights[1],
                    lower * weights[0],
                    lower * weights[1],
                );
            }
        }
    }
    product
}

/// Adds the rows of a pixel to `HᵀH` and `Hᵀr`, the landmark not eliminated.
pub(crate) fn add_pixel(
    pixel: &PixelMeasurement,
    state: &ActiveState,
    layout: &Layout,
    information: &mut Information,
) {
    let columns = columns_of(pixel, state, layout);
    for (k, (column, own)) in columns.clone().enumerate() {
        information.vector[column] += own.dot(&pixel.residual);
        for (row, other) in columns.clone().skip(k) {
            information.matrix[(row, column)] += own.dot(&other);
        }
    }
}

/// The non-zero columns of a pixel in the layout, in ascending order, with their values.
pub(crate) fn columns_of<'a>(
    pixel: &'a PixelMeasurement,
    state: &ActiveState,
    layout: &Layout,
) -> impl Iterator<Item = (usize, Vector2<f64>)> + Clone + 'a {
    let own = (layout.clone_column(pixel.clone_index), &pixel.wrt_clone);
    let other = pixel.neighbour.as_ref().map(|(index, wrt)| (layout.clone_column(*index), wrt));
    let (before, after): (Option<(usize, &Matrix2x6<f64>)>, _) =
        if other.is_some_and(|(column, _)| column < own.0) { (other, None) } else { (None, other) };
    let camera =
        if layout.calibration.is_empty() { 0..0 } else { state.calibration.camera_range(pixel.camera) };
    let wrt_camera = camera.zip(pixel.wrt_camera.column_iter());
    let clones = before.into_iter().chain(std::iter::once(own)).chain(after);
    let wrt_clone = clones.flat_map(|(begin, wrt)| (begin..begin + POSE_DIM).zip(wrt.column_iter()));
    let wrt_camera = wrt_camera.map(|(column, own)| (column, own.into_owned()));
    wrt_camera.chain(wrt_clone.map(|(column, own)| (column, own.into_owned())))
}
