//! A landmark and the clones that observe it, for unit tests.

use crate::calibration::{CalibratedCamera, Calibration, OnlineCalibration};
use crate::odometry::tracks::CloneObservation;
use crate::propagation::{ImuState, MotionEstimate};
use crate::rolling_shutter::motion_around::MotionAround;
use crate::state::{ActiveState, Block, CloneId, ClonedPose};
use geometry::{Camera, Distortion, Pose, rotation};
use nalgebra::{DMatrix, Matrix3, Vector2, Vector3};
use std::sync::Arc;

/// Eight clones on a bow around a landmark, the newest estimates a little off the first ones.
pub struct Scene {
    pub state: ActiveState,
    pub observations: Vec<CloneObservation>,
    /// In L, metres.
    pub landmark: Vector3<f64>,
    pub sigma_px: f64,
}

/// # Arguments
/// * `calibrating`: two cameras, all of whose calibration is estimated; else one that is known.
pub fn scene(calibrating: bool) -> Scene {
    let camera = |distortion| Camera {
        width: 640,
        height: 480,
        focal: [400.0; 2],
        centre: [320.0, 240.0],
        distortion,
    };
    let mounted =
        |y: f64| Pose::new(rotation::exp(&Vector3::new(0.1, 0.2, -0.3)), Vector3::new(0.05, y, 0.0));
    let mut cameras = vec![CalibratedCamera::new(camera(Distortion::None), mounted(0.1))];
    if calibrating {
        let lens = Distortion::RadialTangential([-0.1, 0.02, 1e-3, -1e-3]);
        cameras.push(CalibratedCamera::new(camera(lens), mounted(-0.1)));
    }
    let online = OnlineCalibration {
        extrinsics: calibrating,
        intrinsics: calibrating,
        time_offset: calibrating,
        ..OnlineCalibration::default()
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
                pins: 0,
                motion: None,
            }
        })
        .collect();
    let mut observations = Vec::new();
    for clone in &clones {
        for (camera, calibrated) in cameras.iter().enumerate() {
            let pixel =
                calibrated.predict(&clone.local_from_imu, &landmark).unwrap() + Vector2::new(0.3, -0.2);
            observations.push(CloneObservation { clone: clone.id, camera: camera as u8, pixel });
        }
    }
    let imu = ImuState {
        local_from_imu: clones[7].local_from_imu,
        velocity: Vector3::zeros(),
        gyroscope_bias: Vector3::zeros(),
        accelerometer_bias: Vector3::zeros(),
    };
    let first_motion = MotionEstimate { position: imu.local_from_imu.translation, velocity: imu.velocity };
    let calibration = Calibration::new(cameras, 0.0, online);
    let state = ActiveState {
        stamp_ns: 8,
        imu,
        first_motion,
        calibration,
        wheels: None,
        transform: None,
        slam_features: Vec::new(),
        clones,
    };
    Scene { state, observations, landmark, sigma_px: 1.2 }
}

/// The scene seen by a camera with a rolling shutter, with a readout time that is estimated: images 0.1 s apart, and estimates that differ from
/// the motion between them by some 20 mm and 3 mrad, or by nothing.
pub fn rolling_scene(readout_s: f64, agrees: bool) -> Scene {
    let Scene { mut state, mut observations, landmark, sigma_px } = scene(false);
    let online = OnlineCalibration { readout_time: true, ..OnlineCalibration::default() };
    let mut cameras = state.calibration.cameras;
    cameras[0].readout_s = readout_s;
    state.calibration = Calibration::new(cameras, 0.0, online);
    let wave = |k: f64| Vector3::new((1.3 * k).sin(), (2.9 * k).cos(), (0.7 * k).sin());
    for index in 0..state.clones.len() {
        let k = index as f64;
        let pose = |seconds: f64| {
            let (turned, moved) = (wave(k) * seconds, wave(k + 3.0) * seconds);
            (seconds, Pose::new(rotation::exp(&(turned * (1.0 + 3.0 * seconds))), moved * (1.0 + seconds)))
        };
        let since_before = index.checked_sub(1).map(|before| {
            let between = state.clones[before].local_from_imu.inverse() * state.clones[index].local_from_imu;
            let other = Pose::new(rotation::exp(&(2e-3 * wave(k + 5.0))), 0.015 * wave(k + 7.0));
            (0.1, if agrees { between } else { between * other })
        });
        let motion = MotionAround::new(
            &[pose(-0.005), pose(-0.01), pose(-0.015)],
            &[pose(0.005), pose(0.01), pose(0.015)],
            since_before,
        );
        state.clones[index].motion = Some(Arc::new(motion));
    }
    for (index, observation) in observations.iter_mut().enumerate() {
        // Rows all over the image; the landmark is where all of them would see it to some pixels.
        observation.pixel += Vector2::new(0.0, 2.0 * (index as f64).sin());
    }
    Scene { state, observations, landmark, sigma_px }
}

/// How a turn and a translation of L move the clones, at their first estimates: six columns over the whole state.
pub fn gauge_of_clones(state: &ActiveState) -> DMatrix<f64> {
    let mut gauge = DMatrix::zeros(state.dim(), 6);
    for (index, clone) in state.clones.iter().enumerate() {
        let begin = state.range(Block::Clone(index)).unwrap().start;
        let position = clone.first_estimate.translation;
        gauge.fixed_view_mut::<3, 3>(begin, 0).copy_from(&Matrix3::identity());
        gauge.fixed_view_mut::<3, 3>(begin + 3, 0).copy_from(&-rotation::skew(&position));
        gauge.fixed_view_mut::<3, 3>(begin + 3, 3).copy_from(&Matrix3::identity());
    }
    gauge
}
