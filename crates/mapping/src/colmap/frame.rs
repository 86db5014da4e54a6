//! The frame of a COLMAP model: its unit of length in metres, and where gravity points in it.

use crate::error::BuildError;
use crate::imu_alignment::{ImuAlignment, upright_from};
use crate::joint_covariance::SCALE_SIGMA;
use estimator::EstimatorConfig;
use geometry::{Pose, median};
use map_io::colmap::{ColmapImage, ColmapModel};
use nalgebra::{UnitQuaternion, Vector3};
use sensors::Sequence;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Relative standard deviation of a scale that stereo calibration gives: calibrated baselines are off by about so much.
const SIGMA_SCALE: f64 = 0.01;
/// A scale that is known no better than this tells a robot little.
const MAX_SIGMA_SCALE: f64 = 0.05;
/// Smallest number that names an image by its time: a second, and in 1973 since 1970 (ns).
const LEAST_STAMP_NS: i64 = 1_000_000_000;
const LEAST_TIME_OF_DAY_NS: i64 = 100_000_000_000_000_000;
/// From the median absolute deviation to a standard deviation, for normal errors.
const MAD_TO_SIGMA: f64 = 1.4826;

/// How G lies in a model's frame.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct ColmapFrame {
    /// Metres in the model's unit of length.
    pub scale: f64,
    /// Relative standard deviation of the scale.
    pub sigma_scale: f64,
    /// Rotation from the model's frame to G.
    pub global_from_model: UnitQuaternion<f64>,
    /// What is known of gravity.
    pub gravity: Option<Gravity>,
}

/// The direction of gravity.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Gravity {
    /// Unit vector in which gravity points, in G.
    pub in_global: Vector3<f64>,
    /// Standard deviation of the tilt (rad).
    pub sigma_rad: f64,
}

impl ColmapFrame {
    /// A model that is metric already, or whose unit of length is known. G is its frame, turned so that z is up where gravity is
    /// known.
    ///
    /// # Arguments
    /// * `scale`: metres in the model's unit of length.
    /// * `sigma_scale`: relative standard deviation of the scale.
    /// * `gravity`: direction in which gravity points in the model's frame, where known; it is taken as exact.
    pub fn given(scale: f64, sigma_scale: f64, gravity: Option<Vector3<f64>>) -> ColmapFrame {
        let global_from_model = gravity.as_ref().map_or_else(UnitQuaternion::identity, upright_from);
        let gravity = gravity.map(|_| Gravity { in_global: -Vector3::z(), sigma_rad: 0.0 });
        ColmapFrame { scale, sigma_scale, global_from_model, gravity }
    }

    /// The frame of a model of a recording's images: the baseline of its stereo pairs, or without any the IMU, gives the
    /// unit of length, the IMU the direction of gravity. G has z up.
    ///
    /// Images belong to the recording's by their time stamps, which their names state (`cam0/1403715273262142976.jpg`), or
    /// [`stamp_images`] where the recording has an offset between the clocks of cameras and IMU; those in a folder named `cam1` are of
    /// its second camera.
    ///
    /// # Arguments
    /// * `scale`: known metres in the model's unit of length with their relative standard deviation; `None` to find them.
    ///
    /// # Errors
    /// [`BuildError::ColmapScale`] where neither gives the scale, [`BuildError::TooFewRegistered`] and
    /// [`BuildError::ContradictsImu`] where the readings do not fit.
    pub fn of_recording(
        model: &ColmapModel,
        sequence: &Sequence,
        scale: Option<(f64, f64)>,
        config: &EstimatorConfig,
    ) -> Result<ColmapFrame, BuildError> {
        let images = stamped(model);
        let pose = |(&(stamp_ns, camera), image): (&(i64, usize), &&ColmapImage)| {
            (camera == 0).then_some((stamp_ns, image.world_from_camera))
        };
        let poses: Vec<(i64, Pose)> = images.iter().filter_map(pose).collect();
        let known = scale.or_else(|| stereo_scale(&images, sequence));
        let alignment = ImuAlignment::new(sequence, &poses, known.map(|(scale, _)| scale), config)?;
        // An accelerometer is calibrated to a thousandth, however many of its readings there are.
        let (scale, sigma_scale) =
            known.unwrap_or((alignment.scale, alignment.sigma_scale.hypot(SCALE_SIGMA)));
        if !(scale > 0.0 && sigma_scale < MAX_SIGMA_SCALE) {
            return Err(BuildError::ColmapScale { percent: 100.0 * sigma_scale });
        }
        let gravity = Gravity { in_global: -Vector3::z(), sigma_rad: alignment.sigma_tilt };
        let global_from_model = upright_from(&alignment.gravity);
        Ok(ColmapFrame { scale, sigma_scale, global_from_model, gravity: Some(gravity) })
    }

    /// A pose of the model in G, metric.
    pub(super) fn pose(&self, world_from_camera: &Pose) -> Pose {
        Pose::new(
            self.global_from_model * world_from_camera.rotation,
            self.point(&world_from_camera.translation),
        )
    }

    /// A point of the model in G, metric.
    pub(super) fn point(&self, in_model: &Vector3<f64>) -> Vector3<f64> {
        self.global_from_model * in_model * self.scale
    }
}

/// The number that is an image's name.
fn number(name: &str) -> Option<i64> {
    Path::new(name).file_stem()?.to_str()?.parse().ok()
}

/// States when the images of a model were taken by the clock of a recording's IMU: the names of its images are times of the cameras'
/// clock, to which the recording adds an offset (Kalibr's `timeshift_cam_imu`). Where more names are times of its frames as they are, as
/// those of an exported map, they stay.
///
/// # Arguments
/// * `sequence`: with its frames.
/// * `time_offset_ns`: what the recording adds to the recorded stamps of its frames.
pub fn stamp_images(model: &mut ColmapModel, sequence: &Sequence, time_offset_ns: i64) {
    let frames: BTreeSet<i64> = sequence.frames.iter().map(|frame| frame.stamp_ns).collect();
    let of_frame = |image: &ColmapImage, offset_ns: i64| {
        number(&image.name)
            .and_then(|stamp_ns| stamp_ns.checked_add(offset_ns))
            .filter(|stamp_ns| frames.contains(stamp_ns))
    };
    let count =
        |offset_ns: i64| model.images.values().filter(|image| of_frame(image, offset_ns).is_some()).count();
    let offset_ns = if count(0) > count(time_offset_ns) { 0 } else { time_offset_ns };
    for image in model.images.values_mut() {
        image.stamp_ns = of_frame(image, offset_ns);
    }
}

/// When an image was taken (ns), where that is known or its name says so: a number that is a time of day, or in a recording's folder of a
/// camera one of at least a second. Images that people count have smaller numbers, which are no times.
pub(super) fn stamp_ns(image: &ColmapImage) -> Option<i64> {
    image.stamp_ns.or_else(|| stated_by(&image.name))
}

fn stated_by(name: &str) -> Option<i64> {
    let of_recording = Path::new(name)
        .parent()
        .and_then(Path::file_name)
        .is_some_and(|folder| folder == "cam0" || folder == "cam1");
    let least = if of_recording { LEAST_STAMP_NS } else { LEAST_TIME_OF_DAY_NS };
    number(name).filter(|stamp_ns| *stamp_ns >= least)
}

/// The images whose time is known or their name, by time stamp and camera.
fn stamped<'m>(model: &'m ColmapModel) -> BTreeMap<(i64, usize), &'m ColmapImage> {
    let stamped = |image: &'m ColmapImage| {
        let second = Path::new(&image.name).components().any(|part| part.as_os_str() == "cam1");
        let stamp_ns = image.stamp_ns.or_else(|| number(&image.name))?;
        Some(((stamp_ns, usize::from(second)), image))
    };
    model.images.values().filter_map(stamped).collect()
}

/// Metres in the unit of length by the median stereo pair, and the relative standard deviation; `None` without pairs.
fn stereo_scale(images: &BTreeMap<(i64, usize), &ColmapImage>, sequence: &Sequence) -> Option<(f64, f64)> {
    let [first, second, ..] = &sequence.cameras[..] else { return None };
    let baseline = (first.imu_from_camera.translation - second.imu_from_camera.translation).norm();
    let ratio = |(&(stamp_ns, camera), image): (&(i64, usize), &&ColmapImage)| {
        let other = images.get(&(stamp_ns, 1)).filter(|_| camera == 0)?;
        let apart = image.world_from_camera.translation - other.world_from_camera.translation;
        Some(baseline / apart.norm()).filter(|ratio| ratio.is_finite())
    };
    let mut ratios: Vec<f64> = images.iter().filter_map(ratio).collect();
    let scale = median(&mut ratios)?;
    let mut deviations: Vec<f64> = ratios.iter().map(|ratio| (ratio / scale - 1.0).abs()).collect();
    let scatter = MAD_TO_SIGMA * median(&mut deviations)? / (ratios.len() as f64).sqrt();
    Some((scale, SIGMA_SCALE.hypot(scatter)))
}
