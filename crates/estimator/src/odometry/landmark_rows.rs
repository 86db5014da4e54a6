//! What the images say of one landmark: the rows of its pixels, and how to take the landmark's own error out of them.
//!
//! With `H_x`, `H_f` the whitened Jacobians by the state and by the landmark and `A = H_fᵀ H_f`, projecting the rows onto
//! the left null space of `H_f` leaves
//! ```text
//! HᵀH = H_xᵀ H_x - C A⁻¹ Cᵀ     Hᵀr = H_xᵀ r - C A⁻¹ H_fᵀ r     rᵀr = |r|² - |A^-½ H_fᵀ r|²,     C = H_xᵀ H_f
//! ```
//! which is block diagonal by clones less a matrix of rank three: no projection is worked out. The three directions that
//! are left out initialize the landmark: `f = A⁻¹ H_fᵀ (r - H_x e - n)`, independent of the others.
//!
//! Source: Mourikis & Roumeliotis, ICRA 2007, section III-D; the Schur complement of the normal equations; Li & Mourikis,
//! "Optimization-based estimator design for vision-aided inertial navigation", RSS 2012 (landmarks in the state).

use crate::linear_algebra::NotPositiveDefinite;
use crate::linear_algebra::dense::{Dense, Factorization};
use crate::measurement::Information;
use crate::odometry::pixel_rows::{Layout, PixelRows, RowBlocks, add_pixel, columns_of, covariance_between};
use crate::state::ActiveState;
use nalgebra::{Cholesky, Matrix3, Vector3};
use std::ops::Range;

/// All pixels of one landmark, in memory that is used again.
#[derive(Clone, Debug, Default)]
pub struct LandmarkRows {
    /// One entry a pixel.
    pub pixels: Vec<PixelRows>,
    /// `C`, by the columns of the [`Layout`].
    cross: Vec<[f64; 3]>,
    /// `C A^-½`, transposed.
    reduced: [Vec<f64>; 3],
    gate: GateMemory,
}

/// Memory of the gate.
#[derive(Clone, Debug, Default)]
struct GateMemory {
    blocks: Vec<RowBlocks>,
    innovation: Dense,
    sides: Dense,
    factorization: Factorization,
}

/// How landmarks depend on the rest when they enter the state: `e_f = J e + n`, one after the other.
#[derive(Clone, Debug, Default)]
pub struct Entrance {
    /// What is added to each point that the rows were linearized at, metres in L.
    pub shifts: Vec<Vector3<f64>>,
    /// Covariance of each `n`, m^2.
    pub noises: Vec<Matrix3<f64>>,
    /// Transposed `J` of each over the columns of the layout, as many entries a landmark.
    jacobians: Vec<[f64; 3]>,
}

impl Entrance {
    /// Forgets all landmarks.
    pub fn clear(&mut self) {
        self.shifts.clear();
        self.noises.clear();
        self.jacobians.clear();
    }

    /// `J` of all landmarks, three rows each.
    pub fn jacobian(&self, target: &mut Dense) {
        let count = self.shifts.len();
        let width = self.jacobians.len() / count.max(1);
        target.reset(3 * count, width);
        for (place, jacobian) in self.jacobians.chunks_exact(width.max(1)).enumerate() {
            for (column, values) in jacobian.iter().enumerate() {
                target.column_mut(column)[3 * place..3 * place + 3].copy_from_slice(values);
            }
        }
    }
}

/// The landmark's part of the normal equations.
#[derive(Clone, Copy, Debug)]
struct Own {
    information: Matrix3<f64>,
    vector: Vector3<f64>,
    residual: f64,
}

impl LandmarkRows {
    /// How many rows are left without the landmark.
    pub fn free_rows(&self) -> usize {
        (2 * self.pixels.len()).saturating_sub(3)
    }

    fn own(&self) -> Own {
        let mut own = Own { information: Matrix3::zeros(), vector: Vector3::zeros(), residual: 0.0 };
        for pixel in &self.pixels {
            own.information += pixel.of_landmark.tr_mul(&pixel.of_landmark);
            own.vector += pixel.of_landmark.tr_mul(&pixel.residual);
            own.residual += pixel.residual.norm_squared();
        }
        own
    }

    /// The normalized innovation squared, freed of the landmark: exact, or a bound that is at most `enough`.
    ///
    /// It is at most what the residual is without the landmark, so a small residual need not be weighed.
    ///
    /// # Errors
    /// [`NotPositiveDefinite`] when the filter's covariance is broken.
    pub fn innovation_squared(
        &mut self,
        state: &ActiveState,
        covariance: &Dense,
        layout: &Layout,
        enough: f64,
    ) -> Result<f64, NotPositiveDefinite> {
        let own = self.own();
        let factor = Cholesky::new(own.information).ok_or(NotPositiveDefinite)?;
        let bound = own.residual - own.vector.dot(&factor.solve(&own.vector));
        if bound <= enough {
            return Ok(bound);
        }
        let count = 2 * self.pixels.len();
        let GateMemory { innovation, sides, blocks, factorization } = &mut self.gate;
        innovation.reset(count, count);
        sides.reset(count, 4);
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
            sides.view_mut().fixed_view_mut::<2, 1>(2 * i, 0).copy_from(&pixel.residual);
            sides.view_mut().fixed_view_mut::<2, 3>(2 * i, 1).copy_from(&pixel.of_landmark);
        }
        factorization.cholesky(innovation)?;
        sides.solve_lower(innovation);
        let dot = |a: usize, b: usize| -> f64 {
            sides.column(a).iter().zip(sides.column(b)).map(|(x, y)| x * y).sum()
        };
        let of_landmark = Matrix3::from_fn(|row, column| dot(1 + row, 1 + column));
        let vector = Vector3::from_fn(|row, _| dot(1 + row, 0));
        let factor = Cholesky::new(of_landmark).ok_or(NotPositiveDefinite)?;
        Ok(dot(0, 0) - vector.dot(&factor.solve(&vector)))
    }

    /// Adds what is left without the landmark.
    ///
    /// # Arguments
    /// * `information`: over the columns of `layout`.
    ///
    /// # Errors
    /// [`NotPositiveDefinite`] where the pixels do not fix the landmark.
    pub fn add_to(
        &mut self,
        information: &mut Information,
        state: &ActiveState,
        layout: &Layout,
    ) -> Result<(), NotPositiveDefinite> {
        let own = self.own();
        let factor = Cholesky::new(own.information).ok_or(NotPositiveDefinite)?.unpack();
        self.sum_cross(state, layout);
        for pixel in &self.pixels {
            add_pixel(pixel, state, layout, information);
        }
        let forward = |v: &Vector3<f64>| factor.solve_lower_triangular_unchecked(v);
        let vector = forward(&own.vector);
        for part in &mut self.reduced {
            part.clear();
        }
        for (sum, cross) in information.vector.iter_mut().zip(&self.cross) {
            let reduced = forward(&Vector3::from(*cross));
            for (part, value) in self.reduced.iter_mut().zip(reduced.iter()) {
                part.push(*value);
            }
            *sum -= reduced.dot(&vector);
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
        information.residual += own.residual - vector.norm_squared();
        information.rows += self.free_rows();
        Ok(())
    }

    /// The columns that its pixels touch: calibration, then the clones from the first to the last.
    fn spans(&self, layout: &Layout) -> [Range<usize>; 2] {
        let places = self.pixels.iter().map(|pixel| pixel.place);
        let (first, last) =
            places.fold((usize::MAX, 0), |(low, high), place| (low.min(place), high.max(place)));
        [0..layout.calibration.len(), layout.of_clone(first.min(last))..layout.of_clone(last + 1)]
    }

    /// Works out `C`.
    fn sum_cross(&mut self, state: &ActiveState, layout: &Layout) {
        self.cross.clear();
        self.cross.resize(layout.len(), [0.0; 3]);
        for pixel in &self.pixels {
            for (column, own) in columns_of(pixel, state, layout) {
                let cross = pixel.of_landmark.tr_mul(&own);
                self.cross[column].iter_mut().zip(cross.iter()).for_each(|(sum, value)| *sum += value);
            }
        }
    }

    /// Adds how the landmark enters the state; see [`Entrance`].
    ///
    /// # Errors
    /// [`NotPositiveDefinite`] where the pixels do not fix the landmark.
    pub fn enter(
        &mut self,
        entrance: &mut Entrance,
        state: &ActiveState,
        layout: &Layout,
    ) -> Result<(), NotPositiveDefinite> {
        let own = self.own();
        let noise = Cholesky::new(own.information).ok_or(NotPositiveDefinite)?.inverse();
        self.sum_cross(state, layout);
        entrance.shifts.push(noise * own.vector);
        entrance.noises.push(noise);
        let jacobian = self.cross.iter().map(|cross| <[f64; 3]>::from(-(noise * Vector3::from(*cross))));
        entrance.jacobians.extend(jacobian);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measurement::StateBlocks;
    use crate::odometry::pixel_rows::pixel_rows;
    use crate::state::POSE_DIM;
    use crate::test_scene::{Scene, scene};
    use geometry::numeric::numeric_jacobian;
    use nalgebra::{DMatrix, DVector};

    fn linearized(scene: &Scene, first_estimates: bool) -> LandmarkRows {
        let pixels = scene.sightings.iter().map(|sighting| {
            let seen = (sighting.clone, usize::from(sighting.camera), sighting.pixel);
            pixel_rows(
                &scene.state,
                seen,
                &scene.landmark,
                first_estimates.then_some(&scene.landmark),
                scene.sigma_px,
            )
            .unwrap()
        });
        LandmarkRows { pixels: pixels.collect(), ..LandmarkRows::default() }
    }

    fn information(scene: &Scene, rows: &mut LandmarkRows) -> Information {
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
            let mut calibration = scene.state.calibration.clone();
            calibration.retract(&error.rows(0, begin));
            let point = scene.landmark + error.fixed_rows::<3>(width);
            let pixels = scene.sightings.iter().flat_map(|sighting| {
                let place = scene.state.place_of(sighting.clone).unwrap();
                let step = error.fixed_rows::<6>(begin + POSE_DIM * place).into();
                let pose = scene.state.clones[place].local_from_imu.retract(&step);
                let eye = &calibration.rig[usize::from(sighting.camera)];
                let pixel = eye.predict(&pose, &point).unwrap() / scene.sigma_px;
                [pixel.x, pixel.y]
            });
            DVector::from_iterator(2 * scene.sightings.len(), pixels)
        })
    }

    fn residual(rows: &LandmarkRows) -> DVector<f64> {
        DVector::from_iterator(
            2 * rows.pixels.len(),
            rows.pixels.iter().flat_map(|pixel| [pixel.residual.x, pixel.residual.y]),
        )
    }

    fn apart(a: &DMatrix<f64>, b: &DMatrix<f64>) -> f64 {
        (a - b).amax() / b.amax()
    }

    #[test]
    fn a_track_sees_neither_where_its_frame_is_nor_how_it_is_turned_about_gravity() {
        let scene = scene(false);
        for first_estimates in [true, false] {
            let mut rows = linearized(&scene, first_estimates);
            let information = information(&scene, &mut rows);
            let mut gauge = DMatrix::zeros(POSE_DIM * scene.state.clones.len(), 4);
            for (place, clone) in scene.state.clones.iter().enumerate() {
                let at = if first_estimates { clone.first_estimate } else { clone.local_from_imu };
                let up = Vector3::z();
                gauge.fixed_view_mut::<3, 1>(POSE_DIM * place, 0).copy_from(&up);
                gauge.fixed_view_mut::<3, 1>(POSE_DIM * place + 3, 0).copy_from(&up.cross(&at.translation));
                gauge.fixed_view_mut::<3, 3>(POSE_DIM * place + 3, 1).fill_with_identity();
            }
            let seen = information.matrix.view() * gauge;
            assert!(
                seen.amax() < 1e-12 * information.matrix.view().amax(),
                "{first_estimates}: {}",
                seen.amax()
            );
            assert_eq!(information.rows, 2 * scene.sightings.len() - 3);
        }
    }

    #[test]
    fn the_information_is_that_of_the_pixels_with_the_landmark_eliminated() {
        for calibrating in [false, true] {
            let scene = scene(calibrating);
            let mut rows = linearized(&scene, false);
            let information = information(&scene, &mut rows);
            let numeric = numeric(&scene);
            let width = numeric.ncols() - 3;
            let (of_state, of_landmark) = (numeric.columns(0, width), numeric.columns(width, 3));
            let inverse = of_landmark.tr_mul(&of_landmark).try_inverse().unwrap();
            let count = numeric.nrows();
            let hat = DMatrix::identity(count, count) - of_landmark * &inverse * of_landmark.transpose();
            let residual = residual(&rows);
            let expected = of_state.transpose() * &hat * of_state;
            assert!(apart(&information.matrix.view().into_owned(), &expected) < 1e-7);
            let vector = of_state.transpose() * &hat * &residual;
            let given = DMatrix::from_column_slice(width, 1, &information.vector);
            assert!(apart(&given, &DMatrix::from_column_slice(width, 1, vector.as_slice())) < 1e-6);
            assert!((information.residual - residual.dot(&(&hat * &residual))).abs() < 1e-8);

            // The three directions that are left out are the least-squares estimate of the landmark.
            let mut entrance = Entrance::default();
            rows.enter(&mut entrance, &scene.state, &Layout::of(&scene.state)).unwrap();
            let solve = &inverse * of_landmark.transpose();
            let mut jacobian = Dense::default();
            entrance.jacobian(&mut jacobian);
            assert!(apart(&jacobian.view().into_owned(), &-(&solve * of_state)) < 1e-7);
            assert!((entrance.shifts[0] - &solve * &residual).amax() < 1e-7);
            assert!((entrance.noises[0] - inverse).amax() < 1e-9);
        }
    }

    #[test]
    fn the_gate_weighs_a_track_as_if_its_rows_were_projected() {
        for calibrating in [false, true] {
            let scene = scene(calibrating);
            let mut rows = linearized(&scene, false);
            let layout = Layout::of(&scene.state);
            let dim = scene.state.dim();
            let draw = DMatrix::from_fn(dim, dim, |row, column| {
                ((5 * row + 3 * column + row * column) as f64).sin()
            });
            let covariance = (&draw * draw.transpose()) * 1e-6;
            let dense = Dense::from(covariance.clone());
            let given = rows.innovation_squared(&scene.state, &dense, &layout, 0.0).unwrap();

            let numeric = numeric(&scene);
            let width = numeric.ncols() - 3;
            let of_landmark = numeric.columns(width, 3).into_owned();
            let columns: Vec<usize> = layout.runs().flatten().collect();
            let (jacobian, rest) = crate::linear_algebra::null_space::project_out(
                of_landmark,
                numeric.columns(0, width).into_owned(),
                residual(&rows),
            );
            let joint = covariance.select_rows(&columns).select_columns(&columns);
            let count = rest.len();
            let innovation = &jacobian * joint * jacobian.transpose() + DMatrix::identity(count, count);
            let expected = rest.dot(&innovation.cholesky().unwrap().solve(&rest));
            assert!((given - expected).abs() < 1e-5 * expected, "{given} {expected}");
            let bound = rows.innovation_squared(&scene.state, &dense, &layout, f64::INFINITY).unwrap();
            assert!((bound - rest.norm_squared()).abs() < 1e-6 * bound && bound > given);
        }
    }
}
