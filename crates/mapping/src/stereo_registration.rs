//! Odometry of stereo images that are too far apart to track points: each pair of images is located by the landmarks of
//! earlier ones, and the IMU gives gravity, velocities and biases to the trajectory.

use estimator::EstimatorConfig;
use estimator::imu::ImuBuffer;
use estimator::propagation::{GYROSCOPE_BIAS, ImuState, MotionEstimate, Propagated, propagate};
use geometry::pnp::{Correspondence, PnpSolution, RansacOptions, solve_ransac};
use geometry::pose::Pose;
use geometry::rotation::log;
use geometry::uncertain_pose::PoseWithCovariance;
use nalgebra::{DVector, Matrix3, UnitQuaternion, Vector2, Vector3};
use sensors::Sequence;
use vision::{MatchOptions, match_descriptors};

use super::camera::{CameraPose, MappingCamera};
use super::error::BuildError;
use super::feature_source::{Extraction, FeatureSource, FrameFeatures};
use super::inertial::{IMU_SLACK_NS, buffered};
use super::keyframe_selection::rays;
use super::keyframe_view::KeyframeView;
use super::odometry::Odometry;
use super::options::FIRST_SIGMA_PX;
use super::progress::{Progress, Stage};
use super::sparse_system::SparseSystem;
use super::triangulation::{Scene, triangulate};

/// A pair of images is compared with this many before it first; with all others only where these are not enough.
const RECENT: usize = 4;
/// Fewest matches that agree with a pose: recognition needs as many to trust a keyframe without a second one.
const MIN_INLIERS: usize = 20;
/// With so many the search ends.
const ENOUGH_INLIERS: usize = 120;
/// Longest interval from which gravity and velocities are found (s): integration errors grow with its square.
const MAX_INTERVAL_S: f64 = 4.0;
/// Standard deviations of a position from the images (m), and of a change of velocity by the IMU (m/s for each second).
const ALIGNMENT_SIGMAS: [f64; 2] = [0.02, 0.05];
/// Plausible magnitudes of gravity as the images and the IMU give it (m/s^2).
const PLAUSIBLE_GRAVITY: [f64; 2] = [9.3, 10.3];

/// A pair of images whose pose is known.
struct Located<'a> {
    view: KeyframeView<'a>,
    /// Its landmarks in its own camera frame, by feature.
    points: Vec<Option<Vector3<f64>>>,
    /// In the frame of the first pair of images.
    first_from_camera: Pose,
}

/// Odometry of stereo images at any rate, by their features and the IMU.
///
/// # Arguments
/// * `sequence`: with two cameras, their images and readings of the IMU.
/// * `extraction`: how features are extracted.
/// * `config`: noise of the IMU and magnitude of gravity.
///
/// # Errors
/// [`BuildError`]: fewer than three pairs of images show one place, or images and IMU contradict each other.
pub fn register_stereo_images(
    sequence: &Sequence,
    extraction: Extraction<'_>,
    config: &EstimatorConfig,
    progress: Progress<'_>,
) -> Result<Odometry, BuildError> {
    let cameras = MappingCamera::of_sensors(&sequence.cameras);
    let mut source = FeatureSource::new(Some(extraction), &cameras);
    let mut located: Vec<Located<'_>> = Vec::new();
    for (done, frame) in sequence.frames.iter().enumerate() {
        progress(Stage::Odometry, done, sequence.frames.len());
        let Some(features) = source.stereo_features_of(frame)? else { continue };
        let (view, points) = landmarks(&cameras, frame.stamp_ns, features);
        let pose =
            if located.is_empty() { Some(Pose::identity()) } else { locate(&cameras, &located, &view)? };
        if let Some(first_from_camera) = pose {
            located.push(Located { view, points, first_from_camera });
        }
    }
    let imu_from_camera = sequence.cameras[0].imu_from_camera;
    let poses: Vec<(i64, Pose)> = located
        .iter()
        .map(|pair| (pair.view.stamp_ns, pair.first_from_camera.compose(&imu_from_camera.inverse())))
        .collect();
    let states = align_with_imu(sequence, &poses, config)?;
    Ok(Odometry { states, cameras: 2, imu_noise_scale: 1.0, config: config.clone() })
}

/// The landmarks that one pair of images shows.
fn landmarks<'a>(
    cameras: &[MappingCamera],
    stamp_ns: i64,
    FrameFeatures { features, stereo }: FrameFeatures<'a>,
) -> (KeyframeView<'a>, Vec<Option<Vector3<f64>>>) {
    let rays = rays(&cameras[0].camera, &features);
    let prior = PoseWithCovariance::exact(Pose::identity());
    let view = [KeyframeView { stamp_ns, features, tracked: Vec::new(), stereo, rays, prior }];
    let poses = [CameraPose::from(&Pose::identity())];
    let scene = Scene { cameras, views: &view, poses: &poses, sigma_px: FIRST_SIGMA_PX };
    let point = |feature: usize| {
        view[0].stereo_pixel(feature)?;
        let (landmark, _) = triangulate(&scene, &[(0, feature)], 2);
        landmark.map(|landmark| landmark.ray.push(1.0) / landmark.inverse_depth)
    };
    let points = (0..view[0].features.len()).map(point).collect();
    let [view] = view;
    (view, points)
}

/// The pose of a pair of images by the landmarks of another one; `None` where no other shows the same place.
fn locate(
    cameras: &[MappingCamera],
    located: &[Located<'_>],
    view: &KeyframeView<'_>,
) -> Result<Option<Pose>, BuildError> {
    let mut best: Option<(usize, Pose)> = None;
    for (rank, other) in located.iter().rev().enumerate() {
        let inliers = best.as_ref().map_or(0, |(inliers, _)| *inliers);
        if inliers >= ENOUGH_INLIERS || (rank >= RECENT && inliers >= MIN_INLIERS) {
            break;
        }
        let Some(solution) = solve(cameras, other, view)? else { continue };
        if solution.inliers.len() > inliers {
            let pose = other.first_from_camera.compose(&solution.world_from_camera.pose);
            best = Some((solution.inliers.len(), pose));
        }
    }
    Ok(best.map(|(_, pose)| pose))
}

fn solve(
    cameras: &[MappingCamera],
    other: &Located<'_>,
    view: &KeyframeView<'_>,
) -> Result<Option<PnpSolution>, BuildError> {
    let (known, seen) = (other.view.descriptors()?, view.descriptors()?);
    let matches = match_descriptors(seen, known, &MatchOptions::for_metric(known.metric()))?;
    let correspondence = |found: &vision::Match| {
        let point = other.points[found.train]?;
        let [u, v] = view.features.pixels[found.query];
        Some(Correspondence { point, pixel: Vector2::new(f64::from(u), f64::from(v)) })
    };
    let correspondences: Vec<Correspondence> = matches.iter().filter_map(correspondence).collect();
    let options = RansacOptions { min_inliers: MIN_INLIERS, ..RansacOptions::default() };
    Ok(solve_ransac(&cameras[0].camera, &correspondences, &options, FIRST_SIGMA_PX).ok())
}

/// Readings between two poses, integrated from rest without gravity in the frame of the first IMU pose.
struct Interval {
    begin: usize,
    seconds: f64,
    change: Propagated,
}

/// Velocities, biases and the direction of gravity that make the readings of the IMU fit a trajectory.
///
/// # Returns
/// The states in a frame with z up, whose origin is the first pose.
fn align_with_imu(
    sequence: &Sequence,
    poses: &[(i64, Pose)],
    config: &EstimatorConfig,
) -> Result<Vec<(i64, ImuState)>, BuildError> {
    let (intervals, gyroscope_bias) = unbiased_intervals(sequence, poses, config)?;
    let Alignment { velocities, gravity, .. } = velocities_and_gravity(poses, &intervals)?;
    let up_from_first = UnitQuaternion::rotation_between(&gravity, &-Vector3::z())
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
    let local_from_first = Pose::new(up_from_first, -(up_from_first * poses[0].1.translation));
    let state = |(index, (stamp_ns, pose)): (usize, &(i64, Pose))| {
        let state = ImuState {
            local_from_imu: local_from_first.compose(pose),
            velocity: up_from_first * velocities[index],
            gyroscope_bias,
            accelerometer_bias: Vector3::zeros(),
        };
        (*stamp_ns, state)
    };
    Ok(poses.iter().enumerate().map(state).collect())
}

/// Gravity in the frame of a trajectory, as the readings of the IMU say.
///
/// # Arguments
/// * `poses`: of the IMU, with their time stamps (ns), in any frame, metric.
///
/// # Returns
/// Gravity (m/s^2) and the standard deviation of its direction (rad).
///
/// # Errors
/// [`BuildError::TooFewRegistered`], [`BuildError::ContradictsImu`].
pub(super) fn gravity_of(
    sequence: &Sequence,
    poses: &[(i64, Pose)],
    config: &EstimatorConfig,
) -> Result<(Vector3<f64>, f64), BuildError> {
    let (intervals, _) = unbiased_intervals(sequence, poses, config)?;
    let Alignment { gravity, gravity_covariance, .. } = velocities_and_gravity(poses, &intervals)?;
    let largest = gravity_covariance.symmetric_eigenvalues().max();
    Ok((gravity, largest.sqrt() / gravity.norm()))
}

/// The readings between poses, integrated with the bias of the gyroscope that the rotations of the poses show.
fn unbiased_intervals(
    sequence: &Sequence,
    poses: &[(i64, Pose)],
    config: &EstimatorConfig,
) -> Result<(Vec<Interval>, Vector3<f64>), BuildError> {
    let readings = buffered(&sequence.imu_samples);
    let without_bias = intervals(&readings, poses, Vector3::zeros(), config);
    if poses.len() < 3 || without_bias.len() < 2 {
        return Err(BuildError::TooFewRegistered { images: sequence.frames.len(), located: poses.len() });
    }
    let gyroscope_bias = gyroscope_bias(poses, &without_bias);
    Ok((intervals(&readings, poses, gyroscope_bias, config), gyroscope_bias))
}

fn intervals(
    readings: &ImuBuffer,
    poses: &[(i64, Pose)],
    gyroscope_bias: Vector3<f64>,
    config: &EstimatorConfig,
) -> Vec<Interval> {
    let rest = ImuState::at_rest(gyroscope_bias, Vector3::zeros());
    let interval = |(begin, ends): (usize, &[(i64, Pose)])| {
        let seconds = (ends[1].0 - ends[0].0) as f64 * 1e-9;
        let between = readings.interval(ends[0].0, ends[1].0, IMU_SLACK_NS).ok();
        let between = between.filter(|_| seconds <= MAX_INTERVAL_S)?;
        let change = propagate(&rest, &MotionEstimate::of(&rest), &between, &config.imu_noise, 0.0);
        Some(Interval { begin, seconds, change })
    };
    poses.windows(2).enumerate().filter_map(interval).collect()
}

/// The bias by which the integrated rotations differ from those of the images, by linear least squares.
fn gyroscope_bias(poses: &[(i64, Pose)], intervals: &[Interval]) -> Vector3<f64> {
    let (mut information, mut gradient) = (Matrix3::zeros(), Vector3::zeros());
    for Interval { begin, change, .. } in intervals {
        let (begin, end) = (&poses[*begin].1.rotation, &poses[begin + 1].1.rotation);
        let integrated = change.state.local_from_imu.rotation;
        let residual = log(&(begin.inverse() * end * integrated.inverse()));
        let by_bias: Matrix3<f64> = change.transition.fixed_view::<3, 3>(0, GYROSCOPE_BIAS).into();
        information += by_bias.transpose() * by_bias;
        gradient += by_bias.transpose() * residual;
    }
    information.try_inverse().map_or_else(Vector3::zeros, |inverse| inverse * gradient)
}

/// How a trajectory moves, in its own frame.
struct Alignment {
    /// Of each pose (m/s).
    velocities: Vec<Vector3<f64>>,
    /// m/s^2.
    gravity: Vector3<f64>,
    gravity_covariance: Matrix3<f64>,
}

/// The velocity of each pose and gravity, in the frame of the poses, by linear least squares:
/// ```text
/// p_j - p_i = v_i T + g T^2 / 2 + R_i dp,   v_j - v_i = g T + R_i dv
/// ```
///
/// # Errors
/// [`BuildError::ContradictsImu`] for a gravity that is none, [`BuildError::Indefinite`].
fn velocities_and_gravity(poses: &[(i64, Pose)], intervals: &[Interval]) -> Result<Alignment, BuildError> {
    let dim = 3 * poses.len() + 3;
    let mut system = SparseSystem::new(dim);
    let mut right = DVector::zeros(dim);
    // So weak that it changes nothing but velocities that no interval determines.
    (0..dim).for_each(|index| system.add_diagonal(index, 1e-6));
    for Interval { begin, seconds: t, change } in intervals {
        let (first, second) = (&poses[*begin].1, &poses[begin + 1].1);
        let moved =
            second.translation - first.translation - first.rotation * change.state.local_from_imu.translation;
        let gained = first.rotation * change.state.velocity;
        for axis in 0..3 {
            let unknowns = [3 * begin + axis, 3 * begin + 3 + axis, dim - 3 + axis];
            let rows = [
                ([*t, 0.0, 0.5 * t * t], moved[axis], ALIGNMENT_SIGMAS[0]),
                ([-1.0, 1.0, -t], gained[axis], ALIGNMENT_SIGMAS[1] * t),
            ];
            for (row, value, sigma) in rows {
                let row = Vector3::from(row) / sigma;
                system.add(&unknowns, &unknowns, &(row * row.transpose()));
                for (unknown, factor) in unknowns.iter().zip(row.iter()) {
                    right[*unknown] += factor * value / sigma;
                }
            }
        }
    }
    let factor = system.factor().ok_or(BuildError::Indefinite)?;
    let solution = factor.solve(&right);
    let triple = |index: usize| Vector3::from(solution.fixed_rows::<3>(3 * index));
    let gravity = triple(poses.len());
    let magnitude = gravity.norm();
    if !(PLAUSIBLE_GRAVITY[0]..=PLAUSIBLE_GRAVITY[1]).contains(&magnitude) {
        return Err(BuildError::ContradictsImu { gravity: magnitude });
    }
    let inverse = factor.inverse_columns(&[dim - 3, dim - 2, dim - 1]);
    Ok(Alignment {
        velocities: (0..poses.len()).map(triple).collect(),
        gravity,
        gravity_covariance: inverse.fixed_view::<3, 3>(dim - 3, 0).into_owned(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use simulation::{SimulationOptions, simulate};

    #[test]
    fn poses_and_readings_give_gravity_velocities_and_bias() {
        let options = SimulationOptions { duration_s: Some(30.0), ..SimulationOptions::default() };
        let sequence = simulate(&options).unwrap().live;
        let truth = sequence.groundtruth.clone().unwrap();
        // A frame of its own, in which gravity points anywhere.
        let turned =
            Pose::new(geometry::rotation::exp(&Vector3::new(0.8, -1.1, 0.4)), Vector3::new(3.0, -2.0, 5.0));
        let step = truth.len() / 20;
        let rows: Vec<_> = truth.iter().step_by(step).collect();
        let poses: Vec<(i64, Pose)> =
            rows.iter().map(|row| (row.stamp_ns, turned.compose(&row.pose))).collect();
        let config = EstimatorConfig::default();
        let states = align_with_imu(&sequence, &poses, &config).unwrap();
        for (row, (stamp_ns, state)) in rows.iter().zip(&states).take(states.len() - 1) {
            assert_eq!(row.stamp_ns, *stamp_ns);
            let tilt = (state.local_from_imu.rotation.inverse() * Vector3::z())
                .angle(&(row.pose.rotation.inverse() * Vector3::z()));
            assert!(tilt < 0.02, "{tilt} rad");
            let in_imu = |pose: &Pose, velocity: Vector3<f64>| pose.rotation.inverse() * velocity;
            let speed =
                in_imu(&state.local_from_imu, state.velocity) - in_imu(&row.pose, row.velocity.unwrap());
            assert!(speed.norm() < 0.2, "{speed}");
        }
        let mut in_units_of_gravity = sequence.clone();
        in_units_of_gravity.imu_samples.iter_mut().for_each(|reading| reading.accelerometer /= 9.81);
        assert!(matches!(
            align_with_imu(&in_units_of_gravity, &poses, &config),
            Err(BuildError::ContradictsImu { .. })
        ));
    }
}
