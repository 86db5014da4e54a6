//! Mistakes in a calibration with which odometry does not even begin.

use super::Fit;
use anyhow::Result;
use estimator::EstimatorConfig;
use mapping::run_configured;
use sensors::{CameraSensor, Sequence};

/// Odometry fits where at least this part of the images has a pose.
const MIN_POSES: f64 = 0.5;

/// A mistake, and how it is undone.
struct Mistake {
    advice: &'static str,
    undo: fn(&mut Vec<CameraSensor>),
}

const MISTAKES: [Mistake; 2] = [
    Mistake {
        advice: "the extrinsics are inverted: T_BS takes camera coordinates to the IMU's, T_cam_imu of Kalibr is its inverse",
        undo: |cameras| {
            for sensor in cameras {
                sensor.imu_from_camera = sensor.imu_from_camera.inverse();
            }
        },
    },
    Mistake { advice: "the calibrations of both cameras are swapped", undo: |cameras| cameras.reverse() },
];

/// Whether odometry has poses of most images.
pub(super) fn fits(fit: &Fit, sequence: &Sequence) -> bool {
    fit.complaint().is_none() && fit.states as f64 >= MIN_POSES * sequence.frames.len() as f64
}

/// The mistake without which odometry fits.
///
/// # Arguments
/// * `has_tracks`: whether the recording has tracks. Those of images are made anew for each: the gyroscope predicted them by the calibration.
///
/// # Errors
/// Odometry cannot run.
pub(super) fn find(
    sequence: &mut Sequence,
    cameras: usize,
    config: &EstimatorConfig,
    has_tracks: bool,
) -> Result<Option<&'static str>> {
    let stated = sequence.cameras.clone();
    let mut found = None;
    for mistake in MISTAKES {
        (mistake.undo)(&mut sequence.cameras);
        if !has_tracks {
            sequence.frames.iter_mut().for_each(|frame| frame.tracks.clear());
        }
        let run = run_configured(sequence, cameras, config, |_, _| (), |_, _| ())?;
        sequence.cameras.clone_from(&stated);
        if fits(&Fit::of(&run), sequence) {
            found = Some(mistake.advice);
            break;
        }
    }
    Ok(found)
}
