//! The MSCKF update: what tracks say about the clones that saw them.
//!
//! A track is triangulated from the clones' newest estimates, its rows are linearized there, the chi-square gate decides,
//! and the landmark is taken out. First estimates make the rows worse without making the filter more honest: over 40 runs
//! the NEES of a monocular position was 1.24 with them and 1.03 without; all pixels of a track see the same turn of L about
//! gravity. A landmark that enters the state is seen again and again while the clones change, and that adds up (rotation
//! NEES 2.3 after 200 s): it enters by rows at first estimates, where its later rows stand too.
//! An outlying observation is dropped, not its whole track.

use crate::calibration::{CalibratedCamera, Observation};
use crate::covariance::JointCovariance;
use crate::gate::Gate;
use crate::measurement::Information;
use crate::odometry::landmark_rows::{Entrance, LandmarkRows};
use crate::odometry::pixel_rows::{Layout, pixel_rows};
use crate::odometry::tracks::{Sighting, Track};
use crate::state::{ActiveState, Block};
use geometry::triangulation::{TriangulationOptions, View, triangulate};
use geometry::{Camera, Triangulated};
use nalgebra::{Matrix2x3, Matrix2x6, Vector2, Vector3};
use smallvec::SmallVec;

/// What became of the tracks of one frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TrackReport {
    /// Tracks that corrected the state.
    pub used: usize,
    /// Tracks that could not be triangulated.
    pub not_triangulated: usize,
    /// Tracks that the gate rejected.
    pub gated: usize,
    /// Tracks that were left out because there were enough others.
    pub left_out: usize,
    /// Single observations that were dropped as outliers.
    pub dropped_observations: usize,
    /// Landmarks in the state that corrected it.
    pub landmarks: usize,
    /// Landmarks in the state whose pixels the gate rejected.
    pub landmarks_gated: usize,
    /// The body stood still.
    pub standing: bool,
}

/// Settings of the update.
#[derive(Clone, Debug)]
pub struct TrackSettings {
    /// Pixel noise, px.
    pub sigma_px: f64,
    /// Linearize landmarks that enter the state at first estimates.
    pub first_estimates: bool,
    /// The gate on a whole track.
    pub gate: Gate,
    /// The body stands still: tracks without parallax tell its rotation.
    pub standing: bool,
    /// An observation whose residual after triangulation exceeds this many sigmas is an outlier.
    /// Wide, because at that time the clones' own errors are still in the residual.
    pub outlier_sigmas: f64,
    /// Most tracks that one update uses; the longest are preferred.
    pub max_tracks: usize,
}

/// Fewest clones that must have seen a track: two always fit some point well.
const MIN_CLONES: usize = 3;

/// How fast a body may turn while the time offset of its cameras is being found, rad/s.
const FASTEST_TURN: f64 = 1.0;

/// The part of what an uncertain calibration may move a pixel by that a linearization does not tell; it counts as noise.
/// Tuned on 20 simulated runs each of a hand and of a street with cameras that are 2 degrees off: without it the NEES of a
/// monocular pose is 2.3 in the street, with it 1.25; with five times as much, 0.5 for the position in the room.
const NONLINEAR_PART: f64 = 0.02;

/// A distance at which centimetres do not show, metres.
const FAR: f64 = 1000.0;

/// Largest standard deviation of a landmark's depth, as a part of the depth, with which it may enter the state. Its
/// position in L is taken for normally distributed from then on, which a depth known to 10 % is well enough.
const LARGEST_ENTERING_SIGMA: f64 = 0.1;

/// A landmark that is about to enter the state.
#[derive(Clone, Debug)]
pub struct Entering {
    /// The front end's name.
    pub feature_id: u64,
    /// Where its rows were linearized, in L.
    pub position: Vector3<f64>,
}

/// The update's result, in memory that is used again.
#[derive(Clone, Debug, Default)]
pub struct TrackUpdate {
    /// What the tracks say, over calibration and clones.
    pub information: Information,
    /// Landmarks that enter the state.
    pub entering: Vec<Entering>,
    /// How they depend on the rest.
    pub entrance: Entrance,
    rows: LandmarkRows,
}

type Views = SmallVec<[View; 48]>;
type CameraOfView<'a> = SmallVec<[&'a Camera; 48]>;

impl TrackUpdate {
    /// Collects what `tracks` say.
    ///
    /// # Arguments
    /// * `tracks`: put into the order of their use.
    /// * `may_enter`: whether a track, seen by the newest clone, may become a landmark of the state; asked once for each
    ///   that could, in the order of their use.
    pub fn collect(
        &mut self,
        state: &ActiveState,
        covariance: &JointCovariance,
        tracks: &mut [Track],
        settings: &TrackSettings,
        mut may_enter: impl FnMut(&Track) -> bool,
    ) -> TrackReport {
        let mut report = TrackReport { standing: settings.standing, ..TrackReport::default() };
        let layout = Layout::of(state);
        self.begin(&layout);
        let slack = calibration_slack(state, covariance);
        let largest_error = settings.outlier_sigmas * settings.sigma_px + slack;
        let sigma_px = settings.sigma_px.hypot(NONLINEAR_PART * slack);
        // Long tracks say most; the names make the order unique.
        tracks.sort_unstable_by_key(|track| (std::cmp::Reverse(track.sightings.len()), track.feature_id));
        for track in tracks.iter_mut().filter(|track| track.clones() >= MIN_CLONES) {
            if report.used >= settings.max_tracks {
                report.left_out += 1;
                continue;
            }
            let triangulated =
                triangulate_robustly(state, &mut track.sightings, sigma_px, largest_error, &mut report);
            let landmark = triangulated
                .as_ref()
                .map(|found| found.position)
                .or_else(|| if settings.standing { far_away(state, &track.sightings) } else { None });
            if landmark.is_none_or(|landmark| !self.linearize(state, track, &landmark, sigma_px, false)) {
                report.not_triangulated += 1;
                continue;
            }
            let bound = settings.gate.bound(self.rows.free_rows());
            let innovation = self.rows.innovation_squared(state, covariance.active(), &layout, bound);
            let plausible = innovation.is_ok_and(|innovation| innovation <= bound);
            if !plausible || self.rows.add_to(&mut self.information, state, &layout).is_err() {
                report.gated += 1;
                continue;
            }
            report.used += 1;
            if let Some(found) = triangulated.filter(|found| is_well_known(found, state, track))
                && may_enter(track)
                && self.linearize(state, track, &found.position, sigma_px, settings.first_estimates)
                && self.rows.enter(&mut self.entrance, state, &layout).is_ok()
            {
                self.entering.push(Entering { feature_id: track.feature_id, position: found.position });
            }
        }
        report
    }

    fn begin(&mut self, layout: &Layout) {
        self.entering.clear();
        self.entrance.clear();
        self.information.blocks.active.clear();
        self.information.blocks.active.extend(layout.runs());
        self.information.clear();
    }

    /// Linearizes all pixels of a track; `false` where one of them cannot be seen from where it was.
    fn linearize(
        &mut self,
        state: &ActiveState,
        track: &Track,
        landmark: &Vector3<f64>,
        sigma_px: f64,
        first_estimates: bool,
    ) -> bool {
        let first = first_estimates.then_some(landmark);
        self.rows.pixels.clear();
        for sighting in &track.sightings {
            let seen = (sighting.clone, usize::from(sighting.camera), sighting.pixel);
            match pixel_rows(state, seen, landmark, first, sigma_px) {
                Some(rows) => self.rows.pixels.push(rows),
                None => return false,
            }
        }
        self.rows.pixels.len() >= 2
    }
}

/// How far a pixel may be off because the calibration is still uncertain (three deviations), px.
///
/// An error of the calibration moves all pixels together; what it leaves of a residual is less. The chi-square gate, which
/// knows the calibration's covariance, decides afterwards.
fn calibration_slack(state: &ActiveState, covariance: &JointCovariance) -> f64 {
    let Some(range) = state.range(Block::Calibration).filter(|range| !range.is_empty()) else { return 0.0 };
    let Some(camera) = state.calibration.rig.first().map(|eye| &eye.camera) else { return 0.0 };
    let corner = [f64::from(camera.width) * 0.5, f64::from(camera.height) * 0.5, 0.0];
    let observation = Observation {
        pixel: Vector2::zeros(),
        in_camera: Vector3::new(corner[0] / camera.focal[0], corner[1] / camera.focal[1], 1.0),
        of_body: Matrix2x6::zeros(),
        of_landmark: Matrix2x3::zeros(),
        of_extrinsics: Matrix2x6::identity() * camera.focal[0],
    };
    let jacobian = state.calibration.camera_jacobian(0, &observation);
    let own = state.calibration.camera_range(0);
    let variance = |k: usize| covariance.active()[(range.start + k, range.start + k)];
    let of_camera =
        own.clone().map(|k| variance(k) * jacobian.column(k - own.start).norm_squared()).sum::<f64>();
    let of_clock = if state.calibration.estimates_time_offset() {
        variance(0) * (FASTEST_TURN * camera.focal[0]).powi(2)
    } else {
        0.0
    };
    3.0 * (of_camera + of_clock).sqrt()
}

/// Triangulates in L, dropping the worst observation as long as it is an outlier and enough are left.
fn triangulate_robustly(
    state: &ActiveState,
    sightings: &mut Vec<Sighting>,
    sigma_px: f64,
    largest_error: f64,
    report: &mut TrackReport,
) -> Option<Triangulated> {
    let rig = &state.calibration.rig;
    let max_dropped = sightings.len() / 4;
    sightings.retain(|sighting| {
        state.place_of(sighting.clone).is_some() && usize::from(sighting.camera) < rig.len()
    });
    for dropped in 0..=max_dropped {
        if sightings.len() < MIN_CLONES {
            return None;
        }
        let mut cameras = CameraOfView::new();
        let mut views = Views::new();
        for sighting in sightings.iter() {
            let eye: &CalibratedCamera = &rig[usize::from(sighting.camera)];
            let clone = &state.clones[state.place_of(sighting.clone)?];
            cameras.push(&eye.camera);
            views.push(View {
                parent_from_camera: clone.local_from_imu * eye.imu_from_camera,
                pixel: sighting.pixel,
                sigma_px,
            });
        }
        let found = triangulate(&cameras, &views, &TriangulationOptions::default()).ok()?;
        let mut worst = (0, 0.0);
        for (place, (camera, view)) in cameras.iter().zip(&views).enumerate() {
            let point = view.parent_from_camera.inverse_transform(&found.position);
            let error = camera.project(&point).map_or(f64::INFINITY, |pixel| (pixel - view.pixel).norm());
            if error > worst.1 {
                worst = (place, error);
            }
        }
        if worst.1 <= largest_error {
            return Some(found);
        }
        if dropped < max_dropped {
            sightings.remove(worst.0);
            report.dropped_observations += 1;
        }
    }
    None
}

/// Whether a landmark may be taken for normally distributed about its position.
fn is_well_known(found: &Triangulated, state: &ActiveState, track: &Track) -> bool {
    let newest = state.clones.last();
    newest.is_some_and(|newest| {
        let away = found.position - newest.local_from_imu.translation;
        let along = away.normalize();
        let sigma = (along.dot(&(found.covariance * along))).sqrt();
        track.newest() == Some(newest.id) && sigma < LARGEST_ENTERING_SIGMA * away.norm()
    })
}

/// A point so far along the first ray that moving does not show: its rows tell rotation only.
fn far_away(state: &ActiveState, sightings: &[Sighting]) -> Option<Vector3<f64>> {
    let first = sightings.first()?;
    let eye = state.calibration.rig.get(usize::from(first.camera))?;
    let clone = &state.clones[state.place_of(first.clone)?];
    let seen = eye.camera.unproject(&first.pixel).ok()?;
    Some((clone.local_from_imu * eye.imu_from_camera).transform(&(Vector3::new(seen.x, seen.y, 1.0) * FAR)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::state::CloneId;
    use crate::test_scene::scene;
    use nalgebra::DMatrix;

    fn settings() -> TrackSettings {
        TrackSettings {
            sigma_px: 1.2,
            first_estimates: true,
            gate: Gate::new(0.95),
            standing: false,
            outlier_sigmas: 5.0,
            max_tracks: 10,
        }
    }

    #[test]
    fn one_outlying_observation_is_dropped_and_a_pixel_that_is_no_number_costs_its_track_only() {
        let scene = scene(false);
        let mut report = TrackReport::default();
        let mut outlying = scene.sightings.clone();
        outlying[3].pixel.x += 60.0;
        let found = triangulate_robustly(&scene.state, &mut outlying, 1.2, 6.0, &mut report).unwrap();
        assert_eq!((report.dropped_observations, outlying.len()), (1, 7));
        assert!(outlying.iter().all(|sighting| sighting.clone != CloneId(3)));
        assert!((found.position - scene.landmark).norm() < 0.1);

        let mut broken = scene.sightings.clone();
        broken[3].pixel.x = f64::NAN;
        let dim = scene.state.dim();
        let covariance = JointCovariance::new(DMatrix::identity(dim, dim) * 1e-4, 4);
        let mut tracks = [
            Track { feature_id: 1, sightings: broken },
            Track { feature_id: 2, sightings: scene.sightings.clone() },
        ];
        let mut update = TrackUpdate::default();
        let report = update.collect(&scene.state, &covariance, &mut tracks, &settings(), |_| true);
        assert_eq!((report.used, report.not_triangulated, update.entering.len()), (1, 1, 1));
        assert_eq!(update.information.rows, 2 * 8 - 3);

        let few = TrackSettings { max_tracks: 1, ..settings() };
        let mut tracks = [3, 2].map(|feature_id| Track { feature_id, sightings: scene.sightings.clone() });
        let report = update.collect(&scene.state, &covariance, &mut tracks, &few, |_| false);
        assert_eq!((report.used, report.left_out, update.entering.len()), (1, 1, 0));
    }
}
