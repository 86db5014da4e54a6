//! Landmarks in the state: seen again in the newest image, they correct it at once.
//!
//! A track that outlives the window would have to begin anew, and what ties its parts together would be lost. Kept in
//! the state, the landmark carries it on. It lives as long as its track; a pixel that the state cannot believe is left out,
//! and a landmark that is implausible several times in a row is given up.

use crate::covariance::JointCovariance;
use crate::gate::Gate;
use crate::linear_algebra::NotPositiveDefinite;
use crate::linear_algebra::dense::Dense;
use crate::measurement::LinearizedMeasurement;
use crate::odometry::pixel_rows::{Layout, PixelRows, RowBlock, RowBlocks, covariance_between, pixel_rows};
use crate::odometry::tracks::TrackObservation;
use crate::state::{ActiveState, Block, CloneId, LANDMARK_DIM, POSE_DIM, SlamFeature};
use nalgebra::{DVector, SMatrix, SVector};
use smallvec::SmallVec;
use std::ops::Range;

/// Implausible images in a row after which a landmark is given up.
const MOST_IMPLAUSIBLE: usize = 3;
/// How far a landmark may have moved since it entered, as a part of its distance: where its rows are linearized is too
/// far from where it is then.
const LARGEST_MOVE: f64 = 0.2;
/// Most cameras whose pixels of one landmark are judged together.
const JUDGED_TOGETHER: usize = 2;

/// The update, in memory that is used again.
#[derive(Clone, Debug, Default)]
pub struct LandmarkUpdate {
    rows: LinearizedMeasurement,
    /// Accepted pixels, each with the place of its landmark.
    accepted: Vec<(usize, PixelRows)>,
    of_landmark: Vec<PixelRows>,
    seen: Vec<usize>,
}

impl LandmarkUpdate {
    /// Corrects the state by what the newest image shows of its first `count` landmarks. What it shows of the others was
    /// used when they entered.
    ///
    /// # Returns
    /// How many landmarks did, and how many were implausible.
    ///
    /// # Errors
    /// [`NotPositiveDefinite`] when the filter's covariance is broken.
    pub fn update(
        &mut self,
        state: &mut ActiveState,
        covariance: &mut JointCovariance,
        count: usize,
        observations: &[TrackObservation],
        settings: &LandmarkSettings,
        correction: &mut DVector<f64>,
    ) -> Result<(usize, usize), NotPositiveDefinite> {
        let Some(newest) = state.clones.last().map(|clone| clone.id) else { return Ok((0, 0)) };
        let layout = Layout::of(state);
        self.accepted.clear();
        let (mut used, mut implausible) = (0, 0);
        for place in 0..count {
            self.linearize(state, place, newest, observations, settings);
            if self.of_landmark.is_empty() {
                continue;
            }
            let plausible =
                is_plausible(&self.of_landmark, place, state, covariance.active(), &layout, settings.gate);
            state.landmarks[place].implausible =
                if plausible { 0 } else { state.landmarks[place].implausible + 1 };
            implausible += usize::from(!plausible);
            if plausible {
                used += 1;
                self.accepted.extend(self.of_landmark.drain(..).map(|rows| (place, rows)));
            }
        }
        if used > 0 {
            self.stack(state, &layout);
            covariance.measurement_update(&self.rows, correction)?;
            state.retract(correction);
        }
        Ok((used, implausible))
    }

    /// The pixels of one landmark in the newest image.
    fn linearize(
        &mut self,
        state: &ActiveState,
        place: usize,
        newest: CloneId,
        observations: &[TrackObservation],
        settings: &LandmarkSettings,
    ) {
        let landmark = &state.landmarks[place];
        let first = settings.first_estimates.then_some(&landmark.first_estimate);
        self.of_landmark.clear();
        let own = observations.iter().filter(|observation| observation.feature_id == landmark.feature_id);
        self.of_landmark.extend(own.take(JUDGED_TOGETHER).filter_map(|observation| {
            let seen = (newest, usize::from(observation.camera), observation.pixel);
            pixel_rows(state, seen, &landmark.position, first, settings.sigma_px)
        }));
    }

    /// All accepted pixels as rows over `[calibration, landmarks, newest clone]`.
    fn stack(&mut self, state: &ActiveState, layout: &Layout) {
        let landmarks = state.landmarks_range();
        let clone = layout.clones.end - POSE_DIM..layout.clones.end;
        let columns = &mut self.rows.blocks;
        columns.keyframes.clear();
        columns.active.clear();
        let runs = [layout.calibration.clone(), landmarks.clone(), clone];
        columns.active.extend(runs.into_iter().filter(|run: &Range<usize>| !run.is_empty()));
        let (count, width) = (2 * self.accepted.len(), columns.len());
        self.rows.upper_triangular = false;
        self.rows.jacobian.reset(count, width);
        self.rows.residual.clear();
        let calibration = layout.calibration.len();
        let mut jacobian = self.rows.jacobian.view_mut();
        for (k, (place, rows)) in self.accepted.iter().enumerate() {
            if calibration > 0 {
                let range = state.calibration.camera_range(rows.camera);
                let own = rows.of_camera.columns(0, range.len());
                jacobian.view_mut((2 * k, range.start), (2, range.len())).copy_from(&own);
            }
            let column = calibration + LANDMARK_DIM * place;
            jacobian.fixed_view_mut::<2, 3>(2 * k, column).copy_from(&rows.of_landmark);
            jacobian.fixed_view_mut::<2, 6>(2 * k, width - POSE_DIM).copy_from(&rows.of_clone);
            self.rows.residual.extend(rows.residual.iter());
        }
    }

    /// Removes the landmarks that the newest image does not show, and those that cannot be believed any more.
    pub fn remove_lost(
        &mut self,
        state: &mut ActiveState,
        covariance: &mut JointCovariance,
        observations: &[TrackObservation],
    ) {
        let Some(newest) = state.clones.last().map(|clone| clone.local_from_imu.translation) else { return };
        let lives = |landmark: &SlamFeature| {
            let moved = (landmark.position - landmark.first_estimate).norm();
            landmark.implausible < MOST_IMPLAUSIBLE
                && moved < LARGEST_MOVE * (landmark.position - newest).norm()
                && observations.iter().any(|observation| observation.feature_id == landmark.feature_id)
        };
        self.seen.clear();
        self.seen.extend((0..state.landmarks.len()).filter(|&place| lives(&state.landmarks[place])));
        if self.seen.len() == state.landmarks.len() {
            return;
        }
        let landmarks = state.landmarks_range();
        let mut source = SmallVec::<[Range<usize>; 64]>::new();
        source.push(0..landmarks.start);
        source.extend(self.seen.iter().filter_map(|&place| state.range(Block::Landmark(place))));
        source.push(landmarks.end..state.dim());
        covariance.gather(&source);
        state.landmarks.retain(lives);
    }
}

/// Settings of the update.
#[derive(Clone, Copy, Debug)]
pub struct LandmarkSettings<'a> {
    /// Pixel noise, px.
    pub sigma_px: f64,
    /// Linearize at first estimates.
    pub first_estimates: bool,
    /// The gate on the pixels of one landmark.
    pub gate: &'a Gate,
}

/// The chi-square gate on the pixels of one landmark in one image.
fn is_plausible(
    pixels: &[PixelRows],
    place: usize,
    state: &ActiveState,
    covariance: &Dense,
    layout: &Layout,
    gate: &Gate,
) -> bool {
    const ROWS: usize = 2 * JUDGED_TOGETHER;
    let Some(landmark) = state.range(Block::Landmark(place)) else { return false };
    let blocks = |pixel: &PixelRows| -> RowBlocks {
        let mut blocks = pixel.blocks(state, layout);
        blocks.push(RowBlock::new(landmark.start, LANDMARK_DIM, pixel.of_landmark.as_slice()));
        blocks
    };
    // Rows that are not there have a residual of zero and do not weigh.
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
