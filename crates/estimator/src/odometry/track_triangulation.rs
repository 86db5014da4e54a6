//! Triangulation of tracks from the newest estimates of their clones, without outliers; and what stands for the landmark of a
//! track without parallax.

use crate::calibration::CalibratedCamera;
use crate::odometry::tracks::{CloneObservation, Track};
use crate::rolling_shutter::row_pose::{Estimates, RowPose};
use crate::state::ActiveState;
use geometry::triangulation::{TriangulationOptions, View, triangulate};
use geometry::{Camera, Pose, Triangulated};
use nalgebra::{Matrix3, Vector3};
use smallvec::SmallVec;

/// Minimum number of clones of a track: two always fit some point well.
pub const MIN_CLONES: usize = 3;

/// Distance without visible parallax, metres.
const DISTANT_M: f64 = 1000.0;
/// Standard deviation of it, metres.
const SIGMA_DISTANT_M: f64 = 300.0;

/// Maximum standard deviation of the depth of a new SLAM feature, as a fraction of the depth: up to 10 % its position in L
/// is well approximated by a normal distribution.
const MAX_INITIAL_DEPTH_SIGMA: f64 = 0.1;

type Views = SmallVec<[View; 48]>;
type CamerasOfViews<'a> = SmallVec<[&'a Camera; 48]>;

/// Triangulates in L; drops the worst observation as long as it is an outlier and enough are left.
///
/// # Arguments
/// * `observations`: become those that are left.
/// * `sigma_px`: pixel noise, px.
/// * `largest_error`: residual beyond which an observation is an outlier, px.
/// * `dropped_observations`: grows by the number of outliers.
pub fn triangulate_robustly(
    state: &ActiveState,
    track: &Track,
    observations: &mut Vec<CloneObservation>,
    sigma_px: f64,
    largest_error: f64,
    dropped_observations: &mut usize,
) -> Option<Triangulated> {
    let cameras = &state.calibration.cameras;
    let max_dropped = track.observations.len() / 4;
    observations.clear();
    observations.extend(track.observations.iter().copied().filter(|observation| {
        state.clone_index(observation.clone).is_some() && usize::from(observation.camera) < cameras.len()
    }));
    for dropped in 0..=max_dropped {
        if observations.len() < MIN_CLONES {
            return None;
        }
        let mut view_cameras = CamerasOfViews::new();
        let mut views = Views::new();
        for observation in observations.iter() {
            let calibrated: &CalibratedCamera = &cameras[usize::from(observation.camera)];
            view_cameras.push(&calibrated.camera);
            views.push(View {
                parent_from_camera: local_from_imu(state, observation)? * calibrated.imu_from_camera,
                pixel: observation.pixel,
                sigma_px,
            });
        }
        let found = triangulate(&view_cameras, &views, &TriangulationOptions::default()).ok()?;
        let mut worst = (0, 0.0);
        for (index, (camera, view)) in view_cameras.iter().zip(&views).enumerate() {
            let point = view.parent_from_camera.inverse_transform(&found.position);
            let error = camera.project(&point).map_or(f64::INFINITY, |pixel| (pixel - view.pixel).norm());
            if error > worst.1 {
                worst = (index, error);
            }
        }
        if worst.1 <= largest_error {
            return Some(found);
        }
        if dropped < max_dropped {
            observations.remove(worst.0);
            *dropped_observations += 1;
        }
    }
    None
}

/// The newest estimate of the IMU's pose when a pixel was taken.
fn local_from_imu(state: &ActiveState, observation: &CloneObservation) -> Option<Pose> {
    let clone = state.clone_index(observation.clone)?;
    let camera = usize::from(observation.camera);
    Some(RowPose::of(state, clone, camera, &observation.pixel, Estimates::Newest).local_from_imu)
}

/// Whether the depth of a landmark observed by the newest clone is accurate enough for a SLAM feature.
pub fn has_accurate_depth(
    found: &Triangulated,
    state: &ActiveState,
    observations: &[CloneObservation],
) -> bool {
    let newest = state.clones.last();
    newest.is_some_and(|newest| {
        let away = found.position - newest.local_from_imu.translation;
        let along = away.normalize();
        let sigma = (along.dot(&(found.covariance * along))).sqrt();
        observations.last().is_some_and(|last| last.clone == newest.id)
            && sigma < MAX_INITIAL_DEPTH_SIGMA * away.norm()
    })
}

/// A point so distant that its pixels depend on the rotation only.
pub struct DistantPoint {
    /// Position in L, metres.
    pub position: Vector3<f64>,
    /// Information about its error, 1/m^2. The pixels do not show its distance at all: without it, the elimination of the
    /// landmark divides by rounding errors, and the rest is information about the tilt that nothing measured.
    pub information: Matrix3<f64>,
}

/// A distant point on the first ray.
pub fn distant_point(state: &ActiveState, observations: &[CloneObservation]) -> Option<DistantPoint> {
    let first = observations.first()?;
    let calibrated = state.calibration.cameras.get(usize::from(first.camera))?;
    let seen = calibrated.camera.unproject(&first.pixel).ok()?;
    let away = Vector3::new(seen.x, seen.y, 1.0) * DISTANT_M;
    let local_from_camera = local_from_imu(state, first)? * calibrated.imu_from_camera;
    let along = (local_from_camera.rotation * away).normalize();
    Some(DistantPoint {
        position: local_from_camera.transform(&away),
        information: along * along.transpose() / (SIGMA_DISTANT_M * SIGMA_DISTANT_M),
    })
}
