//! The measurement of one landmark by all its pixels, with the error of the landmark eliminated.
//!
//! With `H_x`, `H_f` the whitened Jacobians with respect to the state and the landmark and `A = H_fᵀ H_f`, the projection
//! onto the left null space of `H_f` gives
//! ```text
//! HᵀH = H_xᵀ H_x - C A⁻¹ Cᵀ     Hᵀr = H_xᵀ r - C A⁻¹ H_fᵀ r     rᵀr = |r|² - |A^-½ H_fᵀ r|²,     C = H_xᵀ H_f
//! ```
//! which is block diagonal in the clones minus a matrix of rank three: the projection is never computed. The other three
//! directions initialize the landmark: `f = A⁻¹ H_fᵀ (r - H_x e - n)`, with noise independent of the above.
//!
//! The matrix of rank three is computed as `(QᵀH_x)ᵀ (QᵀH_x)` with an orthonormal basis `Q` (`landmark_basis`) of the columns of
//! `H_f`: the Cholesky decomposition of the sum would take rounding errors of `A⁻¹` for information about the absolute position
//! (92 mm became 42 mm within an image).
//!
//! Source: Mourikis & Roumeliotis, ICRA 2007, section III-D; the Schur complement of the normal equations.

use crate::linear_algebra::NotPositiveDefinite;
use crate::linear_algebra::dense::{Dense, Factorization};
use crate::measurement::Information;
use crate::odometry::delayed_initialization::DelayedInitialization;
use crate::odometry::landmark_basis::orthonormalize;
use crate::odometry::pixel_measurement::{
    JacobianBlocks, Layout, PixelMeasurement, add_pixel, columns_of, covariance_between,
};
use crate::state::ActiveState;
use nalgebra::{Cholesky, DVector, Matrix2x3, Matrix3, Vector3};
use std::ops::Range;

/// The linearized pixels of one landmark, with reused memory.
#[derive(Clone, Debug, Default)]
pub struct FeatureMeasurement {
    /// One entry per pixel.
    pub pixels: Vec<PixelMeasurement>,
    /// What is known of the landmark besides its pixels: information about its error, 1/m^2. It is zero at the linearization
    /// point.
    pub prior: Option<Matrix3<f64>>,
    /// `Q` by pixel.
    basis: Vec<Matrix2x3<f64>>,
    /// `H_fᵀ H_x` or `Qᵀ H_x`, by the columns of the [`Layout`].
    cross: Vec<[f64; 3]>,
    /// `Qᵀ H_x`, transposed.
    reduced: [Vec<f64>; 3],
    gate: GateMemory,
}

/// Reused memory of the gate.
#[derive(Clone, Debug, Default)]
struct GateMemory {
    blocks: Vec<JacobianBlocks>,
    innovation: Dense,
    right_sides: Dense,
    factorization: Factorization,
}

/// The landmark block of the normal equations.
#[derive(Clone, Copy, Debug)]
struct LandmarkBlock {
    information: Matrix3<f64>,
    vector: Vector3<f64>,
    residual: f64,
}

impl FeatureMeasurement {
    /// Number of rows after the elimination of the landmark.
    pub fn free_rows(&self) -> usize {
        // A prior of the distance is one more row.
        (2 * self.pixels.len() + usize::from(self.prior.is_some())).saturating_sub(3)
    }

    /// Residuals at another estimate than that of the Jacobians.
    ///
    /// # Arguments
    /// * `ahead`: error of the active state at the point of linearization, as seen from the other estimate.
    pub fn seen_from(&mut self, state: &ActiveState, layout: &Layout, ahead: &DVector<f64>) {
        for pixel in &mut self.pixels {
            pixel.residual += pixel.change(state, layout, ahead);
        }
    }

    fn landmark_block(&self) -> LandmarkBlock {
        let mut block = LandmarkBlock {
            information: self.prior.unwrap_or_default(),
            vector: Vector3::zeros(),
            residual: 0.0,
        };
        for pixel in &self.pixels {
            block.information += pixel.wrt_landmark.tr_mul(&pixel.wrt_landmark);
            block.vector += pixel.wrt_landmark.tr_mul(&pixel.residual);
            block.residual += pixel.residual.norm_squared();
        }
        block
    }

    /// The normalized innovation squared (NIS), landmark eliminated: exact, or an upper bound that is at most `enough`.
    ///
    /// The squared residual without the landmark is an upper bound of the NIS; if that is small enough, no innovation
    /// covariance is computed.
    ///
    /// # Errors
    /// [`NotPositiveDefinite`] when the innovation covariance cannot be factorized.
    pub fn nis(
        &mut self,
        state: &ActiveState,
        covariance: &Dense,
        layout: &Layout,
        enough: f64,
    ) -> Result<f64, NotPositiveDefinite> {
        let landmark = self.landmark_block();
        let factor = Cholesky::new(landmark.information).ok_or(NotPositiveDefinite)?;
        let bound = landmark.residual - landmark.vector.dot(&factor.solve(&landmark.vector));
        if bound <= enough {
            return Ok(bound);
        }
        let count = 2 * self.pixels.len();
        let GateMemory { innovation, right_sides, blocks, factorization } = &mut self.gate;
        innovation.reset(count, count);
        right_sides.reset(count, 4);
        blocks.clear();
        blocks.extend(self.pixels.iter().map(|pixel| pixel.blocks(state, layout)));
        for (i, pixel) in self.pixels.iter().enumerate() {
            for (j, other) in blocks[..=i].iter().enumerate() {
                let block = covariance_between(covariance, &blocks[i], other);
                innovation.view_mut().fixed_view_mut::<2, 2>(2 * i, 2 * j).copy_from(&block);
            }
            for k in 0..2 {
                innovation[(2 * i + k, 2 * i + k)] += 1.0;
            }
            right_sides.view_mut().fixed_view_mut::<2, 1>(2 * i, 0).copy_from(&pixel.residual);
            right_sides.view_mut().fixed_view_mut::<2, 3>(2 * i, 1).copy_from(&pixel.wrt_landmark);
        }
        factorization.cholesky(innovation)?;
        right_sides.solve_lower(innovation);
        let dot = |a: usize, b: usize| -> f64 {
            right_sides.column(a).iter().zip(right_sides.column(b)).map(|(x, y)| x * y).sum()
        };
        let wrt_landmark =
            Matrix3::from_fn(|row, column| dot(1 + row, 1 + column)) + self.prior.unwrap_or_default();
        let vector = Vector3::from_fn(|row, _| dot(1 + row, 0));
        let factor = Cholesky::new(wrt_landmark).ok_or(NotPositiveDefinite)?;
        Ok(dot(0, 0) - vector.dot(&factor.solve(&vector)))
    }

    /// Adds the measurement, landmark eliminated.
    ///
    /// # Arguments
    /// * `information`: over the columns of `layout`.
    ///
    /// # Errors
    /// [`NotPositiveDefinite`] where the pixels do not determine the landmark.
    pub fn add_to(
        &mut self,
        information: &mut Information,
        state: &ActiveState,
        layout: &Layout,
    ) -> Result<(), NotPositiveDefinite> {
        self.basis.clear();
        self.basis.extend(self.pixels.iter().map(|pixel| pixel.wrt_landmark));
        orthonormalize(&mut self.basis, self.prior.unwrap_or_default())?;
        let mut vector = Vector3::zeros();
        let mut residual = 0.0;
        for (pixel, basis) in self.pixels.iter().zip(&self.basis) {
            add_pixel(pixel, state, layout, information);
            vector += basis.tr_mul(&pixel.residual);
            residual += pixel.residual.norm_squared();
        }
        sum_cross(&mut self.cross, self.pixels.iter().zip(&self.basis), state, layout);
        for part in &mut self.reduced {
            part.clear();
        }
        for (sum, reduced) in information.vector.iter_mut().zip(&self.cross) {
            for (part, value) in self.reduced.iter_mut().zip(reduced) {
                part.push(*value);
            }
            *sum -= Vector3::from(*reduced).dot(&vector);
        }
        let [x, y, z] = &self.reduced;
        for span in self.spans(layout) {
            for column in span {
                let (a, b, c) = (x[column], y[column], z[column]);
                for other in self.spans(layout) {
                    let rows = other.start.max(column)..other.end.max(column);
                    let target = &mut information.matrix.column_mut(column)[rows.clone()];
                    let sources = x[rows.clone()].iter().zip(&y[rows.clone()]).zip(&z[rows]);
                    for (number, ((x, y), z)) in target.iter_mut().zip(sources) {
                        *number -= a * x + b * y + c * z;
                    }
                }
            }
        }
        information.residual += residual - vector.norm_squared();
        information.rows += self.free_rows();
        Ok(())
    }

    /// The non-zero columns: calibration, then the clones from the first to the last one that a pixel depends on.
    fn spans(&self, layout: &Layout) -> [Range<usize>; 2] {
        let spans = self.pixels.iter().map(PixelMeasurement::clone_span);
        let (first, last) =
            spans.fold((usize::MAX, 0), |(low, high), (first, last)| (low.min(first), high.max(last)));
        [0..layout.calibration.len(), layout.clone_column(first.min(last))..layout.clone_column(last + 1)]
    }

    /// Adds the initialization of the landmark in the state; see [`DelayedInitialization`].
    ///
    /// # Errors
    /// [`NotPositiveDefinite`] where the pixels do not determine the landmark.
    pub fn initialize(
        &mut self,
        initialization: &mut DelayedInitialization,
        state: &ActiveState,
        layout: &Layout,
    ) -> Result<(), NotPositiveDefinite> {
        let landmark = self.landmark_block();
        let noise = Cholesky::new(landmark.information).ok_or(NotPositiveDefinite)?.inverse();
        let rows = self.pixels.iter().map(|pixel| (pixel, &pixel.wrt_landmark));
        sum_cross(&mut self.cross, rows, state, layout);
        initialization.shifts.push(noise * landmark.vector);
        initialization.noises.push(noise);
        let jacobian = self.cross.iter().map(|cross| <[f64; 3]>::from(-(noise * Vector3::from(*cross))));
        initialization.jacobians.extend(jacobian);
        Ok(())
    }
}

/// Sums up the products of three columns, those of `H_f` or `Q`, with those of `H_x`.
fn sum_cross<'a>(
    cross: &mut Vec<[f64; 3]>,
    pixels: impl Iterator<Item = (&'a PixelMeasurement, &'a Matrix2x3<f64>)>,
    state: &ActiveState,
    layout: &Layout,
) {
    cross.clear();
    cross.resize(layout.len(), [0.0; 3]);
    for (pixel, rows) in pixels {
        for (column, own) in columns_of(pixel, state, layout) {
            let product = rows.tr_mul(&own);
            cross[column].iter_mut().zip(product.iter()).for_each(|(sum, value)| *sum += value);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measurement::StateBlocks;
    use crate::odometry::pixel_measurement::linearize_pixel;
    use crate::rolling_shutter::row_pose::{Estimates, RowPose};
    use crate::state::POSE_DIM;
    use crate::test_scene::{Scene, rolling_scene, scene};
    use geometry::Pose;
    use geometry::numeric::numeric_jacobian;
    use nalgebra::DMatrix;

    fn linearized(scene: &Scene, first_estimates: bool) -> FeatureMeasurement {
        let pixels = scene.observations.iter().map(|observation| {
            let observed = (observation.clone, usize::from(observation.camera), observation.pixel);
            linearize_pixel(
                &scene.state,
                observed,
                &scene.landmark,
                first_estimates.then_some(&scene.landmark),
                scene.sigma_px,
            )
            .unwrap()
        });
        FeatureMeasurement { pixels: pixels.collect(), ..FeatureMeasurement::default() }
    }

    fn information(scene: &Scene, rows: &mut FeatureMeasurement) -> Information {
        let layout = Layout::of(&scene.state);
        let mut information = Information::new(StateBlocks::of_active(layout.runs()));
        rows.add_to(&mut information, &scene.state, &layout).unwrap();
        information.matrix.mirror_lower();
        information
    }

    /// The whitened pixels as a function of the errors of `[calibration, clones, landmark]`: its derivative.
    fn numeric(scene: &Scene) -> DMatrix<f64> {
        let layout = Layout::of(&scene.state);
        let (begin, width) = (layout.calibration.len(), layout.len());
        numeric_jacobian(width + 3, |error| {
            let mut state = scene.state.clone();
            state.calibration.retract(&error.rows(0, begin));
            for (index, clone) in state.clones.iter_mut().enumerate() {
                let step = error.fixed_rows::<6>(begin + POSE_DIM * index).into();
                clone.local_from_imu = clone.local_from_imu.retract(&step);
            }
            let point = scene.landmark + error.fixed_rows::<3>(width);
            let pixels = scene.observations.iter().flat_map(|observation| {
                let index = state.clone_index(observation.clone).unwrap();
                let camera = usize::from(observation.camera);
                let row = RowPose::of(&state, index, camera, &observation.pixel, Estimates::Newest);
                let calibrated = &state.calibration.cameras[camera];
                let pixel = calibrated.predict(&row.local_from_imu, &point).unwrap() / scene.sigma_px;
                [pixel.x, pixel.y]
            });
            DVector::from_iterator(2 * scene.observations.len(), pixels)
        })
    }

    /// A known calibration, one that is estimated, and a rolling shutter whose readout time is.
    fn scenes() -> [Scene; 3] {
        [scene(false), scene(true), rolling_scene(0.03, true)]
    }

    fn residual(rows: &FeatureMeasurement) -> DVector<f64> {
        DVector::from_iterator(
            2 * rows.pixels.len(),
            rows.pixels.iter().flat_map(|pixel| [pixel.residual.x, pixel.residual.y]),
        )
    }

    fn apart(a: &DMatrix<f64>, b: &DMatrix<f64>) -> f64 {
        (a - b).amax() / b.amax()
    }

    #[test]
    fn translation_and_rotation_about_gravity_are_unobservable() {
        // Also where the clones differ from the motion by the readings.
        let rolling = rolling_scene(0.03, false);
        let still_rolling = rolling_scene(0.0, false);
        for (scene, first_estimates) in
            [scene(false), rolling, still_rolling].iter().flat_map(|scene| [(scene, true), (scene, false)])
        {
            let mut rows = linearized(scene, first_estimates);
            let information = information(scene, &mut rows);
            let begin = scene.state.calibration.dim();
            let mut gauge = DMatrix::zeros(begin + POSE_DIM * scene.state.clones.len(), 4);
            for (index, clone) in scene.state.clones.iter().enumerate() {
                let at = if first_estimates { clone.first_estimate } else { clone.local_from_imu };
                let up = Vector3::z();
                gauge.fixed_view_mut::<3, 1>(begin + POSE_DIM * index, 0).copy_from(&up);
                gauge
                    .fixed_view_mut::<3, 1>(begin + POSE_DIM * index + 3, 0)
                    .copy_from(&up.cross(&at.translation));
                gauge.fixed_view_mut::<3, 3>(begin + POSE_DIM * index + 3, 1).fill_with_identity();
            }
            let seen = information.matrix.view() * gauge;
            assert!(
                seen.amax() < 1e-12 * information.matrix.view().amax(),
                "{first_estimates}: {}",
                seen.amax()
            );
            assert_eq!(information.rows, 2 * scene.observations.len() - 3);
        }
    }

    #[test]
    fn the_information_is_that_of_the_pixels_with_the_landmark_eliminated() {
        for scene in scenes() {
            let mut rows = linearized(&scene, false);
            let information = information(&scene, &mut rows);
            let numeric = numeric(&scene);
            let width = numeric.ncols() - 3;
            let (wrt_state, wrt_landmark) = (numeric.columns(0, width), numeric.columns(width, 3));
            let inverse = wrt_landmark.tr_mul(&wrt_landmark).try_inverse().unwrap();
            let count = numeric.nrows();
            let hat = DMatrix::identity(count, count) - wrt_landmark * &inverse * wrt_landmark.transpose();
            let residual = residual(&rows);
            let expected = wrt_state.transpose() * &hat * wrt_state;
            assert!(apart(&information.matrix.view().into_owned(), &expected) < 1e-7);
            let vector = wrt_state.transpose() * &hat * &residual;
            let given = DMatrix::from_column_slice(width, 1, &information.vector);
            assert!(apart(&given, &DMatrix::from_column_slice(width, 1, vector.as_slice())) < 1e-6);
            assert!((information.residual - residual.dot(&(&hat * &residual))).abs() < 1e-8);

            // The other three directions are the least-squares estimate of the landmark.
            let mut initialization = DelayedInitialization::default();
            rows.initialize(&mut initialization, &scene.state, &Layout::of(&scene.state)).unwrap();
            let solve = &inverse * wrt_landmark.transpose();
            let mut jacobian = Dense::default();
            initialization.jacobian(&mut jacobian);
            assert!(apart(&jacobian.view().into_owned(), &-(&solve * wrt_state)) < 1e-7);
            assert!((initialization.shifts[0] - &solve * &residual).amax() < 1e-7);
            assert!((initialization.noises[0] - inverse).amax() < 1e-9);
        }
    }

    #[test]
    fn residuals_seen_from_another_estimate_are_those_there() {
        for mut scene in scenes() {
            let layout = Layout::of(&scene.state);
            let here = residual(&linearized(&scene, false));
            let ahead = DVector::from_fn(scene.state.dim(), |k, _| 1e-4 * (1.3 * k as f64).sin());
            scene.state.retract(&ahead);
            let mut rows = linearized(&scene, false);
            let there = residual(&rows);
            rows.seen_from(&scene.state, &layout, &ahead);
            let (apart, moved) = ((residual(&rows) - &here).norm(), (there - &here).norm());
            assert!(apart < 1e-3 * moved && moved > 0.05, "{apart} {moved}");
        }
    }

    /// Straight at the landmark, by millimetres: its pixels do not depend on its depth but by rounding.
    fn braking() -> Scene {
        let mut scene = scene(false);
        let calibrated = &scene.state.calibration.cameras[0];
        let local_from_camera = scene.state.clones[0].local_from_imu * calibrated.imu_from_camera;
        let camera_from_imu = calibrated.imu_from_camera.inverse();
        let ahead = local_from_camera.rotation * Vector3::z();
        scene.landmark = local_from_camera.translation + 0.7 * ahead;
        for (index, clone) in scene.state.clones.iter_mut().enumerate() {
            let off = Vector3::new(1e-6, -2e-6, 0.0) * index as f64;
            let moved = 4e-4 * index as f64 * ahead + off;
            clone.local_from_imu =
                Pose::new(local_from_camera.rotation, local_from_camera.translation + moved)
                    * camera_from_imu;
            clone.first_estimate = clone.local_from_imu;
        }
        scene
    }

    #[test]
    fn the_information_of_a_landmark_without_visible_depth_is_that_of_the_projected_rows() {
        let scene = braking();
        let mut rows = linearized(&scene, true);
        let information = information(&scene, &mut rows);
        let given = information.matrix.view().into_owned();
        let layout = Layout::of(&scene.state);
        let count = rows.pixels.len();
        let (mut wrt_landmark, mut wrt_state) =
            (DMatrix::zeros(2 * count, 3), DMatrix::zeros(2 * count, layout.len()));
        for (k, pixel) in rows.pixels.iter().enumerate() {
            wrt_landmark.fixed_rows_mut::<2>(2 * k).copy_from(&pixel.wrt_landmark);
            for (column, own) in columns_of(pixel, &scene.state, &layout) {
                wrt_state.fixed_view_mut::<2, 1>(2 * k, column).copy_from(&own);
            }
        }
        let (expected, _) = crate::linear_algebra::null_space::project_out(
            wrt_landmark,
            wrt_state,
            DVector::zeros(2 * count),
        );
        let difference = apart(&given, &expected.tr_mul(&expected));
        assert!(difference < 1e-8, "{difference}");
        assert!(given.symmetric_eigenvalues().min() > -1e-13 * given.amax());
    }

    #[test]
    fn the_nis_is_that_of_the_projected_rows() {
        for scene in scenes() {
            let mut rows = linearized(&scene, false);
            let layout = Layout::of(&scene.state);
            let dim = scene.state.dim();
            let draw = DMatrix::from_fn(dim, dim, |row, column| {
                ((5 * row + 3 * column + row * column) as f64).sin()
            });
            let covariance = (&draw * draw.transpose()) * 1e-6;
            let dense = Dense::from(covariance.clone());
            let given = rows.nis(&scene.state, &dense, &layout, 0.0).unwrap();

            let numeric = numeric(&scene);
            let width = numeric.ncols() - 3;
            let wrt_landmark = numeric.columns(width, 3).into_owned();
            let columns: Vec<usize> = layout.runs().flatten().collect();
            let (jacobian, rest) = crate::linear_algebra::null_space::project_out(
                wrt_landmark,
                numeric.columns(0, width).into_owned(),
                residual(&rows),
            );
            let joint = covariance.select_rows(&columns).select_columns(&columns);
            let count = rest.len();
            let innovation = &jacobian * joint * jacobian.transpose() + DMatrix::identity(count, count);
            let expected = rest.dot(&innovation.cholesky().unwrap().solve(&rest));
            assert!((given - expected).abs() < 1e-5 * expected, "{given} {expected}");
            let bound = rows.nis(&scene.state, &dense, &layout, f64::INFINITY).unwrap();
            assert!((bound - rest.norm_squared()).abs() < 1e-6 * bound && bound > given);
        }
    }
}
