//! Settings of a live source.

use crate::pairing::PAIR_TOLERANCE_NS;
use crate::{Contents, FolderCalibration, ImuUnits, SensorCalibration, WheelReadings};

/// What the frames of a live source are made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum LiveFrames {
    /// Images of the cameras.
    Images,
    /// Tracks of a front end that runs elsewhere.
    Tracks {
        /// Whether features for place recognition come with them.
        features: bool,
    },
}

/// How measurements are put in order.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct LiveSettings {
    /// What is expected.
    pub frames: LiveFrames,
    /// Number of cameras whose images are used, the first ones of the calibration.
    pub cameras: usize,
    /// Whether the calibration states the rate of the cameras; Kalibr's does not.
    pub camera_rate_is_stated: bool,
    /// Largest difference between the stamps of the images of a frame, nanoseconds.
    pub pair_tolerance_ns: i64,
    /// Added to the stamps of images, nanoseconds: the `timeshift_cam_imu` of camera 0.
    pub camera_offset_ns: i64,
    /// Units of the IMU's readings.
    pub imu_units: ImuUnits,
    /// What is expected of the wheels.
    pub wheels: Option<WheelReadings>,
    /// Whether positions of GNSS are expected.
    pub gnss: bool,
    /// Frames that may wait for the estimator, of each of several cameras that are triggered apart; beyond, the oldest is dropped.
    /// Five are a quarter of a second at 20 Hz.
    pub max_waiting_frames: usize,
}

impl LiveSettings {
    /// Images of all cameras that are calibrated.
    pub fn images(calibration: &SensorCalibration) -> Self {
        Self {
            frames: LiveFrames::Images,
            cameras: calibration.cameras.len(),
            camera_rate_is_stated: true,
            pair_tolerance_ns: PAIR_TOLERANCE_NS,
            camera_offset_ns: 0,
            imu_units: ImuUnits::default(),
            wheels: None,
            gnss: false,
            max_waiting_frames: 5,
        }
    }

    /// Images of all cameras of a calibration that was read from files.
    pub fn of_files(calibration: &FolderCalibration) -> Self {
        Self {
            camera_rate_is_stated: calibration.files.cameras.is_none(),
            camera_offset_ns: calibration.time_offset_ns,
            ..Self::images(&calibration.sensors)
        }
    }

    /// What the frames carry.
    pub(super) fn contents(&self) -> Contents {
        let (images, tracks, features) = match self.frames {
            LiveFrames::Images => (true, false, false),
            LiveFrames::Tracks { features } => (false, true, features),
        };
        Contents { frames: None, images, tracks, features, wheels: self.wheels, gnss: self.gnss }
    }
}
