//! The MSCKF update: what tracks say about the clones that saw them.
//!
//! A track is triangulated from the clones' newest estimates, its rows are linearized (at the clones'
//! first estimates, if so configured), the landmark is projected out, the chi-square gate decides.
//! An outlying observation is dropped, not its whole track.

use super::covariance::{Columns, Information, JointCovariance, NotPositiveDefinite};
use super::gate::Gate;
use super::null_space::project_out;
use super::state::{ActiveState, Block, POSE_DIM};
use super::tracks::{Sighting, Track};
use geometry::triangulation::{TriangulationOptions, View, triangulate};
use geometry::{Camera, Pose};
use nalgebra::{DMatrix, DVector, Matrix2x3, Matrix2x6, Vector2, Vector3};

/// A camera of the robot's rig.
#[derive(Clone, Debug, PartialEq)]
pub struct RigCamera {
    /// Its intrinsics.
    pub camera: Camera,
    /// Where it sits on the body.
    pub imu_from_camera: Pose,
}

/// What became of the tracks of one frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TrackReport {
    /// Tracks that corrected the state.
    pub used: usize,
    /// Tracks that could not be triangulated.
    pub not_triangulated: usize,
    /// Tracks that the gate rejected.
    pub gated: usize,
    /// Single observations that were dropped as outliers.
    pub dropped_observations: usize,
    /// The body stood still.
    pub standing: bool,
}

/// Settings of the update.
#[derive(Clone, Debug)]
pub struct TrackSettings {
    /// Pixel noise, px.
    pub sigma_px: f64,
    /// Linearize at first estimates.
    pub first_estimates: bool,
    /// The gate on a whole track.
    pub gate: Gate,
    /// The body stands still: tracks without parallax tell its rotation.
    pub standing: bool,
    /// An observation whose residual after triangulation exceeds this many sigmas is an outlier.
    /// Wide, because at that time the clones' own errors are still in the residual.
    pub outlier_sigmas: f64,
}

/// Fewest clones that must have seen a track: two always fit some point well.
const MIN_CLONES: usize = 3;

/// A distance at which centimetres do not show, metres.
const FAR: f64 = 1000.0;

/// A track as rows free of its landmark.
struct TrackRows {
    places: Vec<usize>,
    jacobian: DMatrix<f64>,
    residual: DVector<f64>,
}

/// Collects what `tracks` say.
///
/// # Errors
/// [`NotPositiveDefinite`] when the filter's covariance is broken.
pub fn collect(
    state: &ActiveState,
    covariance: &JointCovariance,
    rig: &[RigCamera],
    tracks: &[Track],
    settings: &TrackSettings,
) -> Result<(Option<Information>, TrackReport), NotPositiveDefinite> {
    let mut report = TrackReport { standing: settings.standing, ..TrackReport::default() };
    let all: Vec<usize> =
        (0..state.clones.len()).filter_map(|place| state.range(Block::Clone(place))).flatten().collect();
    let mut information = Information::new(Columns { active: all, keyframes: Vec::new() });
    let joint = covariance.joint(&information.columns);
    for track in tracks {
        if track.clones() < MIN_CLONES {
            continue;
        }
        let mut sightings = track.sightings.clone();
        let landmark = triangulate_robustly(state, rig, &mut sightings, settings, &mut report)
            .or_else(|| if settings.standing { far_away(state, rig, &sightings) } else { None });
        let Some(landmark) = landmark else {
            report.not_triangulated += 1;
            continue;
        };
        let Some(rows) = linearize(state, rig, &sightings, &landmark, settings) else {
            report.not_triangulated += 1;
            continue;
        };
        let indices: Vec<usize> =
            rows.places.iter().flat_map(|place| POSE_DIM * place..POSE_DIM * (place + 1)).collect();
        if !plausible(&settings.gate, &joint, &indices, &rows)? {
            report.gated += 1;
            continue;
        }
        report.used += 1;
        add_rows(&mut information, &indices, &rows);
    }
    Ok(((information.rows > 0).then_some(information), report))
}

/// The chi-square gate on `rᵀ (H P Hᵀ + I)⁻¹ r`.
///
/// That is at most `rᵀ r`, so a small residual passes without working it out.
fn plausible(
    gate: &Gate,
    joint: &DMatrix<f64>,
    indices: &[usize],
    rows: &TrackRows,
) -> Result<bool, NotPositiveDefinite> {
    let count = rows.residual.len();
    if gate.accepts(rows.residual.norm_squared(), count) {
        return Ok(true);
    }
    let covariance = joint.select_rows(indices).select_columns(indices);
    let mut innovation = &rows.jacobian * (covariance * rows.jacobian.transpose());
    for k in 0..count {
        innovation[(k, k)] += 1.0;
    }
    let factor = innovation.cholesky().ok_or(NotPositiveDefinite)?;
    Ok(gate.accepts(rows.residual.dot(&factor.solve(&rows.residual)), count))
}

/// Adds rows over the columns `indices` of the information's columns.
fn add_rows(information: &mut Information, indices: &[usize], rows: &TrackRows) {
    let transposed = rows.jacobian.transpose();
    let square = &transposed * &rows.jacobian;
    let vector = &transposed * &rows.residual;
    for (j, &column) in indices.iter().enumerate() {
        for (i, &row) in indices.iter().enumerate() {
            information.matrix[(row, column)] += square[(i, j)];
        }
        information.vector[column] += vector[j];
    }
    information.residual += rows.residual.norm_squared();
    information.rows += rows.residual.len();
}

/// Triangulates in L, dropping the worst observation as long as it is an outlier and enough are left.
fn triangulate_robustly(
    state: &ActiveState,
    rig: &[RigCamera],
    sightings: &mut Vec<Sighting>,
    settings: &TrackSettings,
    report: &mut TrackReport,
) -> Option<Vector3<f64>> {
    let max_dropped = sightings.len() / 4;
    sightings.retain(|sighting| {
        state.place_of(sighting.clone).is_some() && usize::from(sighting.camera) < rig.len()
    });
    for dropped in 0..=max_dropped {
        if sightings.len() < MIN_CLONES {
            return None;
        }
        let mut cameras = Vec::with_capacity(sightings.len());
        let mut views = Vec::with_capacity(sightings.len());
        for sighting in sightings.iter() {
            let eye = &rig[usize::from(sighting.camera)];
            let clone = &state.clones[state.place_of(sighting.clone)?];
            cameras.push(&eye.camera);
            views.push(View {
                parent_from_camera: clone.local_from_imu * eye.imu_from_camera,
                pixel: sighting.pixel,
                sigma_pixel: settings.sigma_px,
            });
        }
        let landmark = triangulate(&cameras, &views, &TriangulationOptions::default()).ok()?.position;
        let mut worst = (0, 0.0);
        for (place, (camera, view)) in cameras.iter().zip(&views).enumerate() {
            let point = view.parent_from_camera.inverse_transform(&landmark);
            let error = camera.project(&point).map_or(f64::INFINITY, |pixel| (pixel - view.pixel).norm());
            if error > worst.1 {
                worst = (place, error);
            }
        }
        if worst.1 <= settings.outlier_sigmas * settings.sigma_px {
            return Some(landmark);
        }
        if dropped < max_dropped {
            sightings.remove(worst.0);
            report.dropped_observations += 1;
        }
    }
    None
}

/// A point so far along the first ray that moving does not show: its rows tell rotation only.
fn far_away(state: &ActiveState, rig: &[RigCamera], sightings: &[Sighting]) -> Option<Vector3<f64>> {
    let first = sightings.first()?;
    let eye = rig.get(usize::from(first.camera))?;
    let clone = &state.clones[state.place_of(first.clone)?];
    let seen = eye.camera.unproject(&first.pixel).ok()?;
    Some((clone.local_from_imu * eye.imu_from_camera).transform(&(Vector3::new(seen.x, seen.y, 1.0) * FAR)))
}

/// Stacks the whitened rows of a track and projects its landmark out.
fn linearize(
    state: &ActiveState,
    rig: &[RigCamera],
    sightings: &[Sighting],
    landmark: &Vector3<f64>,
    settings: &TrackSettings,
) -> Option<TrackRows> {
    let mut places: Vec<usize> =
        sightings.iter().filter_map(|sighting| state.place_of(sighting.clone)).collect();
    places.sort_unstable();
    places.dedup();
    let rows = 2 * sightings.len();
    let mut of_landmark = DMatrix::zeros(rows, 3);
    let mut of_state = DMatrix::zeros(rows, POSE_DIM * places.len());
    let mut residual = DVector::zeros(rows);
    for (k, sighting) in sightings.iter().enumerate() {
        let place = state.place_of(sighting.clone)?;
        let clone = &state.clones[place];
        let eye = &rig[usize::from(sighting.camera)];
        let at = if settings.first_estimates { &clone.first_estimate } else { &clone.local_from_imu };
        let newest = predict(eye, &clone.local_from_imu, landmark)?;
        let (_, of_pose, of_point) = predict_with_jacobians(eye, at, landmark)?;
        let whiten = 1.0 / settings.sigma_px;
        let column = POSE_DIM * places.binary_search(&place).ok()?;
        of_landmark.fixed_view_mut::<2, 3>(2 * k, 0).copy_from(&(of_point * whiten));
        of_state.fixed_view_mut::<2, 6>(2 * k, column).copy_from(&(of_pose * whiten));
        residual.fixed_rows_mut::<2>(2 * k).copy_from(&((sighting.pixel - newest) * whiten));
    }
    let (jacobian, residual) = project_out(of_landmark, of_state, residual);
    Some(TrackRows { places, jacobian, residual })
}

fn predict(eye: &RigCamera, local_from_imu: &Pose, landmark: &Vector3<f64>) -> Option<Vector2<f64>> {
    let in_camera = eye.imu_from_camera.inverse_transform(&local_from_imu.inverse_transform(landmark));
    eye.camera.project(&in_camera).ok()
}

/// The pixel of a point in L, with Jacobians by the pose error of the body (2x6) and by the point (2x3).
pub fn predict_with_jacobians(
    eye: &RigCamera,
    local_from_imu: &Pose,
    landmark: &Vector3<f64>,
) -> Option<(Vector2<f64>, Matrix2x6<f64>, Matrix2x3<f64>)> {
    let in_imu = local_from_imu.inverse_transform(landmark);
    let (of_pose, of_point) = local_from_imu.inverse_transform_jacobians(landmark);
    let in_camera = eye.imu_from_camera.inverse_transform(&in_imu);
    let (pixel, of_ray) = eye.camera.project_with_jacobian(&in_camera).ok()?;
    let of_imu = of_ray * eye.imu_from_camera.rotation.inverse().to_rotation_matrix().into_inner();
    Some((pixel, of_imu * of_pose, of_imu * of_point))
}

#[cfg(test)]
mod tests {
    use super::super::propagation::{ImuState, MotionEstimate};
    use super::super::state::{CloneId, ClonedPose};
    use super::*;
    use geometry::numeric::numeric_jacobian;
    use geometry::{Distortion, rotation};

    /// Eight clones on a bow around a landmark, the newest estimates a little off the first ones.
    fn scene() -> (ActiveState, RigCamera, Vec<Sighting>, Vector3<f64>, TrackSettings) {
        let camera = Camera {
            width: 640,
            height: 480,
            focal: [400.0; 2],
            centre: [320.0, 240.0],
            distortion: Distortion::None,
        };
        let eye = RigCamera {
            camera,
            imu_from_camera: Pose::new(
                rotation::exp(&Vector3::new(0.1, 0.2, -0.3)),
                Vector3::new(0.05, 0.1, 0.0),
            ),
        };
        let landmark = Vector3::new(0.4, -0.3, 6.0);
        let wave = |k: f64| Vector3::new((1.7 * k).sin(), (2.3 * k).cos(), (0.9 * k).sin());
        let clones: Vec<ClonedPose> = (0..8)
            .map(|k| {
                let t = k as f64;
                let newest = Pose::new(
                    rotation::exp(&(0.1 * wave(t))),
                    Vector3::new(0.3 * t - 1.0, 0.1 * t, 0.02 * t * t),
                );
                let turned = rotation::exp(&(2e-3 * wave(t + 9.0))) * newest.rotation;
                let first_estimate = Pose::new(turned, newest.translation + 0.03 * wave(t + 5.0));
                ClonedPose {
                    id: CloneId(k),
                    stamp_ns: k as i64,
                    local_from_imu: newest,
                    first_estimate,
                    pinned: false,
                }
            })
            .collect();
        let see = |clone: &ClonedPose| Sighting {
            clone: clone.id,
            camera: 0,
            pixel: predict(&eye, &clone.local_from_imu, &landmark).unwrap() + Vector2::new(0.3, -0.2),
        };
        let sightings = clones.iter().map(see).collect();
        let imu = ImuState {
            local_from_imu: clones[7].local_from_imu,
            velocity: Vector3::zeros(),
            gyroscope_bias: Vector3::zeros(),
            accelerometer_bias: Vector3::zeros(),
        };
        let first_motion =
            MotionEstimate { position: imu.local_from_imu.translation, velocity: imu.velocity };
        let state = ActiveState { stamp_ns: 8, imu, first_motion, transform: None, clones };
        let settings = TrackSettings {
            standing: false,
            sigma_px: 1.2,
            first_estimates: true,
            gate: Gate::new(0.95),
            outlier_sigmas: 5.0,
        };
        (state, eye, sightings, landmark, settings)
    }

    #[test]
    fn a_track_sees_neither_where_its_frame_is_nor_how_it_is_turned_about_gravity() {
        let (state, eye, sightings, landmark, mut settings) = scene();
        for first_estimates in [true, false] {
            settings.first_estimates = first_estimates;
            let rows =
                linearize(&state, std::slice::from_ref(&eye), &sightings, &landmark, &settings).unwrap();
            let mut gauge = DMatrix::zeros(POSE_DIM * state.clones.len(), 4);
            for (place, clone) in state.clones.iter().enumerate() {
                let at = if first_estimates { clone.first_estimate } else { clone.local_from_imu };
                let up = Vector3::z();
                gauge.fixed_view_mut::<3, 1>(POSE_DIM * place, 0).copy_from(&up);
                gauge.fixed_view_mut::<3, 1>(POSE_DIM * place + 3, 0).copy_from(&up.cross(&at.translation));
                gauge.fixed_view_mut::<3, 3>(POSE_DIM * place + 3, 1).fill_with_identity();
            }
            assert_eq!(rows.residual.len(), 2 * 8 - 3);
            assert!((&rows.jacobian * gauge).amax() < 1e-9, "first estimates: {first_estimates}");
        }
    }

    #[test]
    fn the_rows_of_a_track_are_the_derivative_of_its_pixels_with_the_landmark_eliminated() {
        let (state, eye, sightings, landmark, mut settings) = scene();
        settings.first_estimates = false;
        let rows = linearize(&state, std::slice::from_ref(&eye), &sightings, &landmark, &settings).unwrap();
        let clones = state.clones.len();
        let pixels = |error: &DVector<f64>| {
            let point = landmark + error.fixed_rows::<3>(POSE_DIM * clones);
            let stacked = state.clones.iter().enumerate().flat_map(|(place, clone)| {
                let pose = clone.local_from_imu.retract(&error.fixed_rows::<6>(POSE_DIM * place).into());
                let pixel = predict(&eye, &pose, &point).unwrap() / settings.sigma_px;
                [pixel.x, pixel.y]
            });
            DVector::from_iterator(2 * clones, stacked)
        };
        let numeric = numeric_jacobian(POSE_DIM * clones + 3, pixels);
        let (of_state, of_landmark) =
            (numeric.columns(0, POSE_DIM * clones), numeric.columns(POSE_DIM * clones, 3));
        let inverse = of_landmark.tr_mul(&of_landmark).try_inverse().unwrap();
        let schur = of_state.tr_mul(&of_state)
            - of_state.tr_mul(&of_landmark) * inverse * of_landmark.tr_mul(&of_state);
        assert!((rows.jacobian.tr_mul(&rows.jacobian) - &schur).amax() < 1e-8 * schur.amax());
    }

    #[test]
    fn one_outlying_observation_is_dropped_and_a_pixel_that_is_no_number_costs_its_track_only() {
        let (state, eye, sightings, landmark, settings) = scene();
        let rig = [eye];
        let mut report = TrackReport { standing: settings.standing, ..TrackReport::default() };
        let mut outlying = sightings.clone();
        outlying[3].pixel.x += 60.0;
        let found = triangulate_robustly(&state, &rig, &mut outlying, &settings, &mut report).unwrap();
        assert_eq!((report.dropped_observations, outlying.len()), (1, 7));
        assert!(outlying.iter().all(|sighting| sighting.clone != CloneId(3)));
        assert!((found - landmark).norm() < 0.1);

        let mut broken = sightings;
        broken[3].pixel.x = f64::NAN;
        let covariance = JointCovariance::new(DMatrix::identity(15 + 48, 15 + 48) * 1e-4, 4);
        let tracks = [Track { sightings: broken }];
        let (information, report) = collect(&state, &covariance, &rig, &tracks, &settings).unwrap();
        assert!(information.is_none() && report.not_triangulated == 1);
    }
}
