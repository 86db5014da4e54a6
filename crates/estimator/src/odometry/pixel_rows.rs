//! What one pixel says: two whitened rows over the camera's calibration, the clone that saw it and the landmark.

use crate::calibration::{CAMERA_DIM, CameraJacobian};
use crate::linear_algebra::dense::Dense;
use crate::measurement::Information;
use crate::state::{ActiveState, Block, CloneId, POSE_DIM};
use nalgebra::{Matrix2, Matrix2x3, Matrix2x6, Vector2, Vector3};
use smallvec::SmallVec;
use std::ops::Range;

/// Two whitened rows: one pixel.
#[derive(Clone, Debug)]
pub struct PixelRows {
    /// Which camera saw it.
    pub camera: usize,
    /// Place of the clone that saw it.
    pub place: usize,
    /// By the clone's error.
    pub of_clone: Matrix2x6<f64>,
    /// By the landmark's position in L.
    pub of_landmark: Matrix2x3<f64>,
    /// By the camera's error; only as many columns as are estimated.
    pub of_camera: CameraJacobian,
    /// Pixel less prediction.
    pub residual: Vector2<f64>,
}

/// Where the columns of the odometry's information stand in the active error: calibration, then clones.
#[derive(Clone, Debug, PartialEq)]
pub struct Layout {
    /// The calibration's errors.
    pub calibration: Range<usize>,
    /// The clones' errors.
    pub clones: Range<usize>,
}

impl Layout {
    /// Of a state.
    pub fn of(state: &ActiveState) -> Self {
        let calibration = state.range(Block::Calibration).unwrap_or(0..0);
        Self { calibration, clones: state.clones_begin()..state.dim() }
    }

    /// Both, where there is anything in them.
    pub fn runs(&self) -> impl Iterator<Item = Range<usize>> {
        [self.calibration.clone(), self.clones.clone()].into_iter().filter(|run| !run.is_empty())
    }

    pub(crate) fn of_clone(&self, place: usize) -> usize {
        self.calibration.len() + POSE_DIM * place
    }

    pub(crate) fn len(&self) -> usize {
        self.calibration.len() + self.clones.len()
    }
}

/// Linearizes a pixel; see [`PixelRows`].
///
/// # Arguments
/// * `landmark`: newest estimate, in L.
/// * `first`: where the landmark was first believed to be; the rows stand there and at the clone's first estimate. Without
///   it they stand at the newest estimates.
/// * `sigma_px`: noise of the pixel.
pub fn pixel_rows(
    state: &ActiveState,
    seen: (CloneId, usize, Vector2<f64>),
    landmark: &Vector3<f64>,
    first: Option<&Vector3<f64>>,
    sigma_px: f64,
) -> Option<PixelRows> {
    let (clone, camera, pixel) = seen;
    let place = state.place_of(clone)?;
    let clone = &state.clones[place];
    let eye = state.calibration.rig.get(camera)?;
    let (observation, predicted) = if let Some(first) = first {
        (eye.observe(&clone.first_estimate, first)?, eye.predict(&clone.local_from_imu, landmark)?)
    } else {
        let observation = eye.observe(&clone.local_from_imu, landmark)?;
        (observation, observation.pixel)
    };
    let whiten = 1.0 / sigma_px;
    let of_camera = if state.calibration.dim() > 0 {
        state.calibration.camera_jacobian(camera, &observation) * whiten
    } else {
        CameraJacobian::zeros()
    };
    Some(PixelRows {
        camera,
        place,
        of_clone: observation.of_body * whiten,
        of_landmark: observation.of_landmark * whiten,
        of_camera,
        residual: (pixel - predicted) * whiten,
    })
}

/// Two rows over a run of columns of the active error.
#[derive(Clone, Copy, Debug)]
pub struct RowBlock {
    begin: usize,
    width: usize,
    /// By column, two numbers each.
    values: [f64; 2 * CAMERA_DIM],
}

impl RowBlock {
    /// Of a Jacobian's first `width` columns, given column by column.
    pub fn new(begin: usize, width: usize, jacobian: &[f64]) -> Self {
        let mut values = [0.0; 2 * CAMERA_DIM];
        values[..2 * width].copy_from_slice(&jacobian[..2 * width]);
        Self { begin, width, values }
    }
}

/// The runs of columns that two rows touch.
pub type RowBlocks = SmallVec<[RowBlock; 3]>;

impl PixelRows {
    /// The columns that it touches among the active error's, without the landmark's.
    pub fn blocks(&self, state: &ActiveState, layout: &Layout) -> RowBlocks {
        let mut blocks = RowBlocks::new();
        let begin = layout.clones.start + POSE_DIM * self.place;
        blocks.push(RowBlock::new(begin, POSE_DIM, self.of_clone.as_slice()));
        if !layout.calibration.is_empty() {
            let range = state.calibration.camera_range(self.camera);
            let begin = layout.calibration.start + range.start;
            blocks.push(RowBlock::new(begin, range.len(), self.of_camera.as_slice()));
        }
        blocks
    }
}

/// `H_i P H_jᵀ` of two pixels.
pub fn covariance_between(covariance: &Dense, first: &[RowBlock], second: &[RowBlock]) -> Matrix2<f64> {
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

/// Adds the rows of a pixel as they are to `HᵀH` and `Hᵀr`.
pub(crate) fn add_pixel(
    pixel: &PixelRows,
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

/// The columns of the layout that a pixel touches, in rising order, with its rows.
pub(crate) fn columns_of<'a>(
    pixel: &'a PixelRows,
    state: &ActiveState,
    layout: &Layout,
) -> impl Iterator<Item = (usize, Vector2<f64>)> + Clone + 'a {
    let clone = layout.of_clone(pixel.place);
    let camera =
        if layout.calibration.is_empty() { 0..0 } else { state.calibration.camera_range(pixel.camera) };
    let of_camera = camera.zip(pixel.of_camera.column_iter());
    let of_clone = (clone..clone + POSE_DIM).zip(pixel.of_clone.column_iter());
    let of_camera = of_camera.map(|(column, own)| (column, own.into_owned()));
    of_camera.chain(of_clone.map(|(column, own)| (column, own.into_owned())))
}
