//! What the linearization of a track neglects where the displacement of its camera is not known well.
//!
//! A robot that drives off from rest knows its displacement `b` of some millimetres to `sigma`, as much as itself. Landmarks are triangulated at
//! a distance `d` that is wrong by the same part. A pixel of such a track moves by about `f b / d`; with the relative errors `ε` of displacement
//! and distance, the two terms of second order of `f b (1 + ε) / (d (1 + ε'))` are `f b / d` times `ε ε'` and `ε'^2`, each of about
//! `(sigma / b)^2`. They cancel only where all images are linearized at one scale; with first estimates of clones that were predicted one
//! after the other they do not, and become information about the scale that nothing measured.
//!
//! The more tracks there are, the less their noise hides it: of four cameras with 800 tracks, a rendered drive ended with its scale wrong by a
//! third at 1 % of standard deviation. Stated as noise of the pixels it is more than a pixel while the robot drives off, and
//! a hundredth of one at full speed.
//!
//! Source: Jazwinski, "Stochastic processes and filtering theory", 1970, section 9.3 (the noise of a linearized measurement is increased by
//! its terms of second order).

use crate::calibration::Calibration;
use crate::covariance::JointCovariance;
use crate::odometry::tracks::CloneObservation;
use crate::state::{ActiveState, POSE_DIM};
use nalgebra::Vector3;

/// Terms of second order, each of the square of a relative error.
const TERMS: f64 = 2.0;

/// Number of terms that are counted: none where one camera or stereo pair is the only one.
pub fn terms(calibration: &Calibration) -> f64 {
    if calibration.camera_groups().len() < 2 { 0.0 } else { TERMS }
}

/// Begin of the position in the error of a pose.
const POSITION: usize = 3;

/// A term of second order of the pixels of a track, px; 0 where it ends in another camera than it begins in, as with
/// stereo pairs, whose distance between each other is known.
///
/// # Arguments
/// * `covariance`: of the errors of `state`.
/// * `landmark`: in L, metres.
pub(super) fn second_order_px(
    state: &ActiveState,
    covariance: &JointCovariance,
    observations: &[CloneObservation],
    landmark: &Vector3<f64>,
) -> f64 {
    let (Some(first), Some(last)) = (observations.first(), observations.last()) else { return 0.0 };
    let (Some(begin), Some(end)) = (state.clone_index(first.clone), state.clone_index(last.clone)) else {
        return 0.0;
    };
    let Some(calibrated) = state.calibration.cameras.get(usize::from(first.camera)) else { return 0.0 };
    if first.camera != last.camera {
        return 0.0;
    }
    let position = |index: usize| state.clones[index].local_from_imu.translation;
    let displacement = (position(end) - position(begin)).norm();
    let distance = (landmark - position(end)).norm();
    let variance = displacement_variance(state, covariance, [begin, end]);
    // An error larger than the displacement is no small part of it: the landmark is then anywhere along its ray.
    let larger = displacement.max(variance.sqrt());
    if larger > 0.0 && distance > 0.0 {
        calibrated.camera.focal[0] * variance / (distance * larger)
    } else {
        0.0
    }
}

/// Variance of the displacement between two clones on each axis, m^2.
fn displacement_variance(state: &ActiveState, covariance: &JointCovariance, clones: [usize; 2]) -> f64 {
    let [from, to] = clones.map(|index| state.clones_begin() + POSE_DIM * index + POSITION);
    let active = covariance.active();
    let of_axis = |k: usize| {
        active[(from + k, from + k)] + active[(to + k, to + k)]
            - active[(from + k, to + k)]
            - active[(to + k, from + k)]
    };
    ((0..3).map(of_axis).sum::<f64>() / 3.0).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_scene::scene;
    use nalgebra::DMatrix;

    /// The term of a track between the first and the last clone of the scene, moved `metres` apart.
    fn noise_px(metres: f64, variance: impl Fn(usize, usize) -> f64) -> f64 {
        let mut scene = scene(false);
        let count = scene.state.clones.len();
        let first = scene.state.clones[0].local_from_imu.translation;
        scene.state.clones[count - 1].local_from_imu.translation = first + Vector3::x() * metres;
        let dim = scene.state.dim();
        let active = DMatrix::from_fn(dim, dim, variance);
        let covariance = JointCovariance::new(active, 0);
        let [begin, end] = [0, count - 1].map(|index| scene.state.clones[index].id);
        let observations: Vec<CloneObservation> = scene
            .observations
            .iter()
            .filter(|seen| seen.camera == 0 && (seen.clone == begin || seen.clone == end))
            .copied()
            .collect();
        let landmark = first + Vector3::x() * metres + Vector3::y() * 4.0;
        second_order_px(&scene.state, &covariance, &observations, &landmark)
    }

    #[test]
    fn it_is_the_parallax_times_the_square_of_the_relative_error() {
        let focal = scene(false).state.calibration.cameras[0].camera.focal[0];
        let independent = |sigma: f64| {
            move |row: usize, column: usize| if row == column { 0.5 * sigma * sigma } else { 0.0 }
        };
        for (metres, sigma) in [(0.5, 0.01), (0.5, 0.02), (0.1, 0.02)] {
            let expected = focal * metres / 4.0 * (sigma / metres).powi(2);
            assert!((noise_px(metres, independent(sigma)) - expected).abs() < 1e-9 * expected);
        }
        // Beyond the displacement itself, it is the parallax of the error.
        let expected = focal * 0.05 / 4.0;
        assert!((noise_px(0.01, independent(0.05)) - expected).abs() < 1e-9 * expected);
        // What both clones err by together is no error of their displacement.
        assert!(noise_px(0.5, |_, _| 0.04) < 1e-12);
        assert!(noise_px(0.0, |_, _| 0.0) < 1e-12);
    }
}
