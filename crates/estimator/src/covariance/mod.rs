//! Joint covariance of the active error state and the held keyframes: propagation, rearranging, measurement update.
//!
//! # The measurement update
//! A whitened measurement `r = H e + n`, `n ~ N(0, I)`, depends on a few blocks `C` of the state (clones, SLAM features, the
//! transform, keyframes). With `S = H P_CC Hᵀ + I = L Lᵀ`,
//! ```text
//! W = L⁻¹ H P_CA       dx_A = Wᵀ L⁻¹ r       P_AA -= Wᵀ W
//!                      P_AN -= Wᵀ L⁻¹ H P_CN       x_N, P_NN unchanged (Schmidt)
//! ```
//! which is the extended Kalman filter's update for the active part and Schmidt's for the nuisance part. `P_AA` loses a
//! Gram matrix smaller than itself in one symmetric product, so it stays positive definite where Joseph's form does
//! (tested against that form over many steps). Measurements in information form are compressed first.

use crate::KeyframeId;
use crate::linear_algebra::NotPositiveDefinite;
use crate::linear_algebra::dense::{Dense, Factorization};
use crate::linear_algebra::dependence::Dependence;
use crate::measurement::{Information, LinearizedMeasurement, StateBlocks};
use crate::propagation::{IMU_DIM, ImuMatrix};
use crate::schmidt::HeldKeyframes;
use faer::linalg::matmul::triangular::BlockStructure;
use nalgebra::{Cholesky, DMatrix, DVector, Matrix6};
use std::ops::Range;

/// Memory reused from one update to the next.
#[derive(Clone, Debug, Default)]
struct Workspace {
    compressed: LinearizedMeasurement,
    spare: Dense,
    /// `W`, rows x active.
    whitened: Dense,
    /// `L`, rows x rows.
    innovation: Dense,
    /// `L⁻¹ r`.
    residual: Dense,
    factorization: Factorization,
}

/// Covariance of the active error state and of the held keyframes.
#[derive(Clone, Debug)]
pub struct JointCovariance {
    active: Dense,
    /// `P_AN` and `P_NN`.
    pub held: HeldKeyframes,
    workspace: Workspace,
}

/// Normalized innovation squared (NIS) of measurements in information form.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InformationNis {
    /// Of all rows.
    pub total: f64,
    /// The part that an error of the state explains. Hundreds of pixels hide an error of their common poses in the total; here
    /// it stands alone.
    pub explained: f64,
    /// Degrees of freedom of that part.
    pub rank: usize,
}

impl JointCovariance {
    /// Without held keyframes.
    pub fn new(active: DMatrix<f64>, max_active_keyframes: usize) -> Self {
        let held = HeldKeyframes::new(active.nrows(), max_active_keyframes);
        Self { active: active.into(), held, workspace: Workspace::default() }
    }

    /// `P_AA`.
    pub fn active(&self) -> &Dense {
        &self.active
    }

    /// `P ← F P Fᵀ + Q`, where `F` and `Q` touch only the IMU's rows and columns, which are the first.
    pub fn time_update(&mut self, transition: &ImuMatrix, noise: &ImuMatrix) {
        let dim = self.active.nrows();
        for column in 0..dim {
            let own = &mut self.active.column_mut(column)[..IMU_DIM];
            let mut propagated = [0.0; IMU_DIM];
            for (factors, number) in transition.as_slice().chunks_exact(IMU_DIM).zip(&*own) {
                for (sum, factor) in propagated.iter_mut().zip(factors) {
                    *sum += factor * number;
                }
            }
            own.copy_from_slice(&propagated);
        }
        let block = self.active.view().fixed_view::<IMU_DIM, IMU_DIM>(0, 0) * transition.transpose() + noise;
        let block = (block + block.transpose()) * 0.5;
        self.active.view_mut().fixed_view_mut::<IMU_DIM, IMU_DIM>(0, 0).copy_from(&block);
        for column in IMU_DIM..dim {
            for row in 0..IMU_DIM {
                self.active[(column, row)] = self.active[(row, column)];
            }
        }
        self.held.propagate(transition);
        // Here rather than in a map update, which is to be short.
        self.held.compact();
    }

    /// Rearranges the active error state: it becomes the old ranges `source`, one after the other.
    ///
    /// Cloning repeats a range, marginalization leaves one out.
    pub fn gather(&mut self, source: &[Range<usize>]) {
        self.active.gather(source, &mut self.workspace.spare);
        self.held.gather_rows(source);
    }

    /// `P ← T P Tᵀ` for a `T` that adds multiples of some active errors to others.
    pub fn add_dependences<const R: usize, const C: usize>(&mut self, dependences: &[Dependence<R, C>]) {
        self.active.add_to_rows(dependences);
        self.active.add_to_columns(dependences);
        self.held.add_dependences(dependences);
    }

    /// Augments the active error state at `at` by `e = J e_C + n`, `n ~ N(0, noise)`.
    ///
    /// # Arguments
    /// * `blocks`: `C`, without keyframes; none for an independent `e`.
    /// * `jacobian`: `J`, size of `e` x size of `C`.
    /// * `noise`: diagonal blocks of the covariance of `n`, as many rows together as `jacobian` has.
    pub fn insert(
        &mut self,
        at: usize,
        blocks: &StateBlocks,
        jacobian: &Dense,
        noise: impl Iterator<Item = DMatrix<f64>>,
    ) {
        let (count, dim) = (jacobian.nrows(), self.active.nrows());
        let Workspace { spare: grown, whitened: cross, innovation: own, .. } = &mut self.workspace;
        cross.reset(count, dim);
        own.reset(count, count);
        for (range, here) in blocks.ranges() {
            cross.add_product(jacobian, here, &self.active, range, BlockStructure::Rectangular);
        }
        for (range, here) in blocks.ranges() {
            own.add_lower_outer(cross, range, jacobian, here);
        }
        let mut begin = 0;
        for block in noise {
            let mut target = own.view_mut();
            let mut target = target.view_mut((begin, begin), block.shape());
            target += &block;
            begin += block.nrows();
        }
        own.mirror_lower();

        grown.reset(dim + count, dim + count);
        let new_index = |index: usize| if index < at { index } else { index + count };
        for column in 0..dim {
            let target = grown.column_mut(new_index(column));
            target[..at].copy_from_slice(&self.active.column(column)[..at]);
            target[at + count..].copy_from_slice(&self.active.column(column)[at..]);
            target[at..at + count].copy_from_slice(cross.column(column));
        }
        for k in 0..count {
            let target = grown.column_mut(at + k);
            target[at..at + count].copy_from_slice(own.column(k));
            for column in 0..dim {
                target[new_index(column)] = cross[(k, column)];
            }
        }
        std::mem::swap(&mut self.active, grown);
        self.held.insert_rows(at, blocks, jacobian);
    }

    /// Evicts the least recently used keyframes beyond `max_held` and inflates the covariance of the state accordingly.
    ///
    /// # Returns
    /// How many were evicted.
    pub fn evict(&mut self, max_held: usize) -> usize {
        self.held.evict(max_held, &mut self.active)
    }

    /// Removes keyframes that the map has changed and inflates the covariance of the state accordingly.
    pub fn invalidate(&mut self, ids: &[KeyframeId]) {
        self.held.invalidate(ids, &mut self.active);
    }

    /// Adds independent noise to six numbers of the active error state, from `begin` on.
    pub fn add_noise(&mut self, begin: usize, noise: &Matrix6<f64>) {
        let mut block = self.active.view_mut();
        let mut block = block.fixed_view_mut::<6, 6>(begin, begin);
        block += noise;
    }

    /// Adds independent noise `U Uᵀ` to the active error state.
    ///
    /// # Arguments
    /// * `root`: `U`, as many rows as the state has numbers.
    pub fn add_noise_of_root(&mut self, root: &Dense) {
        let mut active = self.active.view_mut();
        active.gemm(1.0, &root.view(), &root.view().transpose(), 1.0);
    }

    /// Replaces the covariance of errors from `begin` on that are not correlated with any other.
    pub fn replace(&mut self, begin: usize, covariance: &DMatrix<f64>) {
        self.active.view_mut().view_mut((begin, begin), covariance.shape()).copy_from(covariance);
    }

    /// `P_CC`, for the gates on single landmarks.
    pub fn joint(&self, blocks: &StateBlocks) -> DMatrix<f64> {
        let (n_active, n) = (blocks.active_len(), blocks.len());
        let mut joint = DMatrix::zeros(n, n);
        for (rows, row) in blocks.ranges() {
            for (range, here) in blocks.ranges() {
                let block = self.active.view();
                let block = block.view((rows.start, range.start), (rows.len(), range.len()));
                joint.view_mut((row.start, here.start), (row.len(), here.len())).copy_from(&block);
            }
        }
        for (k, &slot) in blocks.keyframes.iter().enumerate() {
            let cross = self.held.cross_covariance(slot);
            let column = n_active + 6 * k;
            for (range, here) in blocks.ranges() {
                let block = cross.rows(range.start, range.len());
                joint.view_mut((here.start, column), (here.len(), 6)).copy_from(&block);
                joint.view_mut((column, here.start), (6, here.len())).copy_from(&block.transpose());
            }
        }
        let own = self.held.covariance_of(&blocks.keyframes);
        joint.view_mut((n_active, n_active), own.shape()).copy_from(&own);
        joint
    }

    /// Normalized innovation squared `rᵀ (H P Hᵀ + I)⁻¹ r`.
    ///
    /// # Errors
    /// [`NotPositiveDefinite`] where `P_CC` is not a covariance.
    pub fn nis(&mut self, measurement: &LinearizedMeasurement) -> Result<f64, NotPositiveDefinite> {
        self.whiten(measurement)?;
        Ok(self.workspace.residual.column(0).iter().map(|value| value * value).sum())
    }

    /// The normalized innovation squared of measurements in information form, and its part that an error of the state explains.
    ///
    /// # Errors
    /// [`NotPositiveDefinite`] where `P_CC` is not a covariance.
    pub fn information_nis(
        &mut self,
        information: &Information,
    ) -> Result<InformationNis, NotPositiveDefinite> {
        self.check_keyframes(&information.blocks)?;
        self.compressed(information, |joint, rows, unexplained| {
            let pivots = (0..rows.jacobian.nrows()).map(|k| rows.jacobian[(k, k)]);
            let largest = pivots.clone().fold(0.0, f64::max);
            let rank = pivots.filter(|pivot| *pivot > MIN_PIVOT * largest).count();
            let explained = joint.nis(rows)?;
            Ok(InformationNis { total: unexplained + explained, explained, rank })
        })
    }

    /// The measurement update for measurements in information form; see [`Self::measurement_update`].
    ///
    /// # Errors
    /// [`NotPositiveDefinite`]: nothing was changed.
    pub fn information_update(
        &mut self,
        information: &Information,
        correction: &mut DVector<f64>,
    ) -> Result<(), NotPositiveDefinite> {
        self.information_update_if(information, correction, |_, _| true).map(|_| ())
    }

    /// The same, if its correction is accepted.
    ///
    /// # Arguments
    /// * `accept`: of the correction of the active state, and the standard deviation of each of its components.
    ///
    /// # Returns
    /// Whether the update was made.
    ///
    /// # Errors
    /// [`NotPositiveDefinite`]: nothing was changed.
    pub fn information_update_if(
        &mut self,
        information: &Information,
        correction: &mut DVector<f64>,
        accept: impl FnOnce(&DVector<f64>, &dyn Fn(usize) -> f64) -> bool,
    ) -> Result<bool, NotPositiveDefinite> {
        self.compressed(information, |joint, rows, _| {
            joint.correction(rows, correction)?;
            // The covariance of the correction is what the update subtracts.
            let sigma =
                |k: usize| joint.workspace.whitened.column(k).iter().map(|w| w * w).sum::<f64>().sqrt();
            let accepted = accept(correction, &sigma);
            if accepted {
                joint.subtract(rows);
            }
            Ok(accepted)
        })
    }

    /// The measurement update; see the module's documentation.
    ///
    /// # Arguments
    /// * `correction`: becomes the correction of the active state.
    ///
    /// # Errors
    /// [`NotPositiveDefinite`]: nothing was changed.
    pub fn measurement_update(
        &mut self,
        measurement: &LinearizedMeasurement,
        correction: &mut DVector<f64>,
    ) -> Result<(), NotPositiveDefinite> {
        self.correction(measurement, correction)?;
        self.subtract(measurement);
        Ok(())
    }

    /// The covariances after the measurement that was whitened last.
    fn subtract(&mut self, measurement: &LinearizedMeasurement) {
        let Workspace { whitened, innovation, .. } = &self.workspace;
        self.active.subtract_gram(whitened);
        self.active.mirror_lower();
        if !self.held.is_empty() {
            self.held.measurement_update(measurement, whitened, innovation);
        }
    }

    /// The correction of [`Self::information_update`], without the update.
    ///
    /// # Errors
    /// [`NotPositiveDefinite`] where `P_CC` is not a covariance.
    pub fn information_correction(
        &mut self,
        information: &Information,
        correction: &mut DVector<f64>,
    ) -> Result<(), NotPositiveDefinite> {
        self.compressed(information, |joint, rows, _| joint.correction(rows, correction))
    }

    /// Applies `function` to the compressed measurement and the part of `rᵀr` that no error state explains.
    fn compressed<T>(
        &mut self,
        information: &Information,
        function: impl FnOnce(&mut Self, &LinearizedMeasurement, f64) -> Result<T, NotPositiveDefinite>,
    ) -> Result<T, NotPositiveDefinite> {
        let mut rows = std::mem::take(&mut self.workspace.compressed);
        let outcome = information
            .compress(&mut rows, &mut self.workspace.factorization)
            .and_then(|unexplained| function(self, &rows, unexplained));
        self.workspace.compressed = rows;
        outcome
    }

    fn correction(
        &mut self,
        measurement: &LinearizedMeasurement,
        correction: &mut DVector<f64>,
    ) -> Result<(), NotPositiveDefinite> {
        self.whiten(measurement)?;
        let Workspace { whitened, residual, .. } = &self.workspace;
        let n = self.active.nrows();
        if correction.len() != n {
            *correction = DVector::zeros(n);
        }
        for (k, value) in correction.iter_mut().enumerate() {
            *value = whitened.column(k).iter().zip(residual.column(0)).map(|(a, b)| a * b).sum();
        }
        Ok(())
    }

    /// Leaves `W`, `L` and `L⁻¹ r` in the workspace.
    fn whiten(&mut self, measurement: &LinearizedMeasurement) -> Result<(), NotPositiveDefinite> {
        let (count, dim) = (measurement.residual.len(), self.active.nrows());
        let Workspace { whitened, innovation, residual, factorization, .. } = &mut self.workspace;
        let jacobian = &measurement.jacobian;
        whitened.reset(count, dim);
        for (range, here) in measurement.blocks.ranges() {
            whitened.add_product(jacobian, here, &self.active, range, measurement.shape());
        }
        innovation.reset(count, count);
        let active_len = measurement.blocks.active_len();
        if !measurement.blocks.keyframes.is_empty() {
            let slots = &measurement.blocks.keyframes;
            let mut of_keyframes = Dense::zeros(measurement.blocks.len(), 6 * slots.len());
            for (k, &slot) in slots.iter().enumerate() {
                let cross = self.held.cross_covariance(slot);
                let transposed = Dense::from(cross.transpose());
                let columns = active_len + 6 * k..active_len + 6 * (k + 1);
                whitened.add_product(jacobian, columns, &transposed, 0..6, BlockStructure::Rectangular);
                for (range, here) in measurement.blocks.ranges() {
                    let mut target = of_keyframes.view_mut();
                    target
                        .view_mut((here.start, 6 * k), (here.len(), 6))
                        .copy_from(&cross.rows(range.start, range.len()));
                }
            }
            let own = self.held.covariance_of(slots);
            of_keyframes.view_mut().rows_mut(active_len, own.nrows()).copy_from(&own);
            let mut product = Dense::zeros(count, 6 * slots.len());
            let all = 0..measurement.blocks.len();
            product.add_product(
                jacobian,
                all.clone(),
                &of_keyframes,
                all.clone(),
                BlockStructure::Rectangular,
            );
            innovation.add_lower_outer(&product, 0..6 * slots.len(), jacobian, active_len..all.end);
        }
        for (range, here) in measurement.blocks.ranges() {
            innovation.add_lower_outer(whitened, range, jacobian, here);
        }
        for k in 0..count {
            innovation[(k, k)] += 1.0;
        }
        factorization.cholesky(innovation)?;
        whitened.solve_lower(innovation);
        residual.reset(count, 1);
        residual.column_mut(0).copy_from_slice(&measurement.residual);
        residual.solve_lower(innovation);
        Ok(())
    }

    /// Rejects a map whose cross-covariances are inconsistent before it can be mistaken for divergence of the filter.
    fn check_keyframes(&self, blocks: &StateBlocks) -> Result<(), NotPositiveDefinite> {
        if blocks.keyframes.is_empty() {
            return Ok(());
        }
        let mut joint = self.held.covariance_of(&blocks.keyframes);
        for k in 0..joint.nrows() {
            // Some keyframes are known exactly.
            joint[(k, k)] += 1e-10 * joint[(k, k)] + MIN_VARIANCE;
        }
        Cholesky::new(joint).map(|_| ()).ok_or(NotPositiveDefinite)
    }
}

/// Smallest pivot, relative to the largest, of a direction that a measurement observes.
const MIN_PIVOT: f64 = 1e-5;

/// Variance added to keyframes in the check, rad^2 or m^2: a nanometre.
const MIN_VARIANCE: f64 = 1e-18;
