//! SLAM features: landmarks in the state, updated with every image that observes them.
//!
//! A track that outlives the window would be split, and the correlation between its parts lost; a landmark in the state
//! keeps it. It stays as long as it is tracked. Pixels that fail the chi-square gate are not used, and a feature that fails
//! it several times in a row is marginalized.

use crate::calibration::Calibration;
use crate::covariance::JointCovariance;
use crate::gate::Gate;
use crate::linear_algebra::NotPositiveDefinite;
use crate::linear_algebra::dense::Dense;
use crate::measurement::LinearizedMeasurement;
use crate::odometry::pixel_measurement::{
    JacobianBlock, JacobianBlocks, Layout, PixelMeasurement, covariance_between, linearize_pixel,
};
use crate::odometry::tracks::ShownCameras;
use crate::state::{ActiveState, Block, CloneId, FEATURE_DIM, POSE_DIM, SlamFeature};
use nalgebra::{DVector, SMatrix, SVector};
use smallvec::SmallVec;
use std::ops::Range;
use types::TrackObservation;

/// Number of consecutive images rejected by the gate after which a feature is marginalized.
const MAX_GATED_IN_A_ROW: usize = 3;
/// Maximum distance of a feature from its point of linearization, as a fraction of its depth: one that an image moves further is
/// not described by its covariance.
const MAX_SHIFT: f64 = 0.2;
/// Standard deviation of what all pixels of a track err alike, px: each image is aligned with the patch of the first one, whose own
/// noise is in all of them, and which fits less and less as the view changes. The pixels of a track in the window are few enough
/// to be taken for independent; a feature that is seen in a hundred images would be known ten times as well as it is. Of images at
/// 20 Hz.
pub const COMMON_ERROR_PX: f64 = 0.5;
/// Time between the images with which both common errors were found, seconds: more images of the same motion say
/// no more about what they err alike.
const REFERENCE_INTERVAL_S: f64 = 0.05;
/// Shortest time between images that is believed, seconds.
const LEAST_INTERVAL_S: f64 = 1e-3;
/// Standard deviation of what the pixels of a camera err by for long, rad, in a rig whose cameras do not see the same. Lasting errors of
/// the tracks of one camera pass for a motion; those of several contradict each other, as an error of the mounting would. Found by trial
/// on rendered drives with four cameras: NEES of rotation and position of 2.8 and 1.7 without it, of 1.4 and 1.3 with it.
const LASTING_ERROR_RAD: f64 = 2e-3;
/// Maximum number of cameras whose pixels of one feature are gated together.
const MAX_CAMERAS: usize = 2;

/// The SLAM feature update, with reused memory.
#[derive(Clone, Debug, Default)]
pub struct SlamUpdate {
    rows: LinearizedMeasurement,
    /// Accepted pixels, each with the index of its feature.
    accepted: Vec<(usize, PixelMeasurement)>,
    /// Pixels of the feature being processed.
    pixels: Vec<PixelMeasurement>,
    kept: Vec<usize>,
    /// Camera and time of its last image, nanoseconds.
    last_images: SmallVec<[(u8, i64); 8]>,
}

impl SlamUpdate {
    /// Updates the state with the pixels of its first `count` features in the newest image. Those of the others were used by
    /// their initialization.
    ///
    /// # Returns
    /// Number of features used, and of features rejected by the gate.
    ///
    /// # Errors
    /// [`NotPositiveDefinite`] when the innovation covariance cannot be factorized.
    pub fn update(
        &mut self,
        state: &mut ActiveState,
        covariance: &mut JointCovariance,
        count: usize,
        observations: &[TrackObservation],
        settings: &SlamUpdateSettings,
        correction: &mut DVector<f64>,
    ) -> Result<(usize, usize), NotPositiveDefinite> {
        let Some(newest) = state.clones.last().map(|clone| clone.id) else { return Ok((0, 0)) };
        let layout = Layout::of(state);
        self.accepted.clear();
        let (mut used, mut gated) = (0, 0);
        for index in 0..count {
            self.linearize(state, index, newest, observations, settings);
            if self.pixels.is_empty() {
                continue;
            }
            let plausible =
                is_plausible(&self.pixels, index, state, covariance.active(), &layout, settings.gate);
            state.slam_features[index].gated_in_a_row =
                if plausible { 0 } else { state.slam_features[index].gated_in_a_row + 1 };
            gated += usize::from(!plausible);
            if plausible {
                used += 1;
                self.accepted.extend(self.pixels.drain(..).map(|rows| (index, rows)));
            }
        }
        if used > 0 {
            self.stack(state, &layout);
            covariance.measurement_update(&self.rows, correction)?;
            state.retract(correction);
        }
        Ok((used, gated))
    }

    /// Linearizes the pixels of one feature in the newest image.
    fn linearize(
        &mut self,
        state: &ActiveState,
        index: usize,
        newest: CloneId,
        observations: &[TrackObservation],
        settings: &SlamUpdateSettings,
    ) {
        let feature = &state.slam_features[index];
        let first = settings.first_estimates.then_some(&feature.first_estimate);
        self.pixels.clear();
        let own = observations.iter().filter(|observation| observation.feature_id == feature.feature_id);
        self.pixels.extend(own.take(MAX_CAMERAS).filter_map(|observation| {
            let observed = (newest, usize::from(observation.camera), observation.pixel);
            let camera = &state.calibration.cameras.get(observed.1)?.camera;
            let sigma_px = settings.sigma_px.hypot(settings.lasting_error_rad * camera.focal[0]);
            linearize_pixel(state, observed, &feature.position, first, sigma_px)
        }));
    }

    /// Stacks all accepted pixels: rows over `[calibration, SLAM features, newest clone]`, with a rolling shutter the newest two
    /// clones.
    fn stack(&mut self, state: &ActiveState, layout: &Layout) {
        let features = state.slam_features_range();
        let has_neighbours = self.accepted.iter().any(|(_, rows)| rows.neighbour.is_some());
        let clones = if has_neighbours { 2 } else { 1 };
        let clone = layout.clones.end - clones * POSE_DIM..layout.clones.end;
        let columns = &mut self.rows.blocks;
        columns.keyframes.clear();
        columns.active.clear();
        let runs = [layout.calibration.clone(), features, clone];
        columns.active.extend(runs.into_iter().filter(|run: &Range<usize>| !run.is_empty()));
        let (count, width) = (2 * self.accepted.len(), columns.len());
        self.rows.upper_triangular = false;
        self.rows.jacobian.reset(count, width);
        self.rows.residual.clear();
        let calibration = layout.calibration.len();
        let mut jacobian = self.rows.jacobian.view_mut();
        for (k, (index, rows)) in self.accepted.iter().enumerate() {
            if calibration > 0 {
                let range = state.calibration.camera_range(rows.camera);
                let own = rows.wrt_camera.columns(0, range.len());
                jacobian.view_mut((2 * k, range.start), (2, range.len())).copy_from(&own);
            }
            let column = calibration + FEATURE_DIM * index;
            jacobian.fixed_view_mut::<2, 3>(2 * k, column).copy_from(&rows.wrt_landmark);
            jacobian.fixed_view_mut::<2, 6>(2 * k, width - POSE_DIM).copy_from(&rows.wrt_clone);
            if let Some((_, wrt_neighbour)) = &rows.neighbour {
                jacobian.fixed_view_mut::<2, 6>(2 * k, width - 2 * POSE_DIM).copy_from(wrt_neighbour);
            }
            self.rows.residual.extend(rows.residual.iter());
        }
    }

    /// Factor on the standard deviation of what the images of a camera err alike, by their rate: 1 at 20 Hz and below.
    ///
    /// # Arguments
    /// * `stamp_ns`: of the observations, nanoseconds.
    pub fn repetition(&mut self, stamp_ns: i64, observations: &[TrackObservation]) -> f64 {
        let Some(camera) = observations.first().map(|observation| observation.camera) else { return 1.0 };
        let known = self.last_images.iter_mut().find(|(known, _)| *known == camera);
        let Some((_, last_ns)) = known else {
            self.last_images.push((camera, stamp_ns));
            return 1.0;
        };
        let interval_s = (stamp_ns - std::mem::replace(last_ns, stamp_ns)) as f64 * 1e-9;
        (REFERENCE_INTERVAL_S / interval_s.max(LEAST_INTERVAL_S)).max(1.0).sqrt()
    }

    /// Marginalizes the features that the newest frame does not observe although it shows their camera, that no clone of the
    /// window has observed, that the gate rejected too often, or that an image moved too far.
    pub fn marginalize_lost(
        &mut self,
        state: &mut ActiveState,
        covariance: &mut JointCovariance,
        observations: &[TrackObservation],
    ) {
        let (Some(oldest), Some(newest)) = (state.clones.first(), state.clones.last()) else { return };
        let (oldest, (newest, position)) = (oldest.id, (newest.id, newest.local_from_imu.translation));
        let shown = ShownCameras::of(observations);
        for feature in &mut state.slam_features {
            if observations.iter().any(|observation| observation.feature_id == feature.feature_id) {
                feature.last_seen = newest;
            }
        }
        let is_kept = |feature: &SlamFeature| {
            let shift = (feature.position - feature.first_estimate).norm();
            let is_tracked = feature.last_seen == newest
                || (feature.last_seen >= oldest && !shown.contains(feature.camera));
            feature.gated_in_a_row < MAX_GATED_IN_A_ROW
                && shift < MAX_SHIFT * (feature.position - position).norm()
                && is_tracked
        };
        self.kept.clear();
        self.kept
            .extend((0..state.slam_features.len()).filter(|&index| is_kept(&state.slam_features[index])));
        if self.kept.len() == state.slam_features.len() {
            return;
        }
        let features = state.slam_features_range();
        let mut source = SmallVec::<[Range<usize>; 64]>::new();
        source.push(0..features.start);
        source.extend(self.kept.iter().filter_map(|&index| state.range(Block::SlamFeature(index))));
        source.push(features.end..state.dim());
        covariance.gather(&source);
        state.slam_features.retain(is_kept);
    }
}

/// What the pixels of a camera err by for long, rad: it does not average out over the many images of a SLAM feature. 0 where one camera or
/// stereo pair is the only one.
pub fn lasting_error_rad(calibration: &Calibration) -> f64 {
    if calibration.camera_groups().len() < 2 { 0.0 } else { LASTING_ERROR_RAD }
}

/// Settings of the SLAM feature update.
#[derive(Clone, Copy, Debug)]
pub struct SlamUpdateSettings<'a> {
    /// Pixel noise, px.
    pub sigma_px: f64,
    /// What the pixels of a camera err by for long, rad: see [`lasting_error_rad`].
    pub lasting_error_rad: f64,
    /// Linearize at first estimates.
    pub first_estimates: bool,
    /// The gate on the pixels of one feature.
    pub gate: &'a Gate,
}

/// The chi-square gate on the pixels of one feature in one image.
fn is_plausible(
    pixels: &[PixelMeasurement],
    index: usize,
    state: &ActiveState,
    covariance: &Dense,
    layout: &Layout,
    gate: &Gate,
) -> bool {
    const ROWS: usize = 2 * MAX_CAMERAS;
    let Some(feature) = state.range(Block::SlamFeature(index)) else { return false };
    let blocks = |pixel: &PixelMeasurement| -> JacobianBlocks {
        let mut blocks = pixel.blocks(state, layout);
        blocks.push(JacobianBlock::new(feature.start, FEATURE_DIM, pixel.wrt_landmark.as_slice()));
        blocks
    };
    // Unused rows have a zero residual and an identity covariance.
    let mut innovation = SMatrix::<f64, ROWS, ROWS>::identity();
    let mut residual = SVector::<f64, ROWS>::zeros();
    for (i, pixel) in pixels.iter().enumerate() {
        let first = blocks(pixel);
        for (j, other) in pixels.iter().enumerate() {
            let mut block = innovation.fixed_view_mut::<2, 2>(2 * i, 2 * j);
            block += covariance_between(covariance, &first, &blocks(other));
        }
        residual.fixed_rows_mut::<2>(2 * i).copy_from(&pixel.residual);
    }
    innovation
        .cholesky()
        .is_some_and(|factor| gate.accepts(residual.dot(&factor.solve(&residual)), 2 * pixels.len()))
}
