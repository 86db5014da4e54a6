//! A recording in memory.

use super::{
    CameraSensor, Contents, Frame, GnssReading, GnssSensor, ImuSample, ImuSensor, PairCounts, ReferencePose,
    SensorCalibration, TruthRow, WheelReading, WheelReadings, WheelSensor, camera_groups,
};
use nalgebra::Vector3;
use std::path::PathBuf;

/// A recorded run in memory, with everything that is known of it.
///
/// [`Sequence::open`] reads one from disk; a simulation makes one. [`Recording::from`](crate::Recording) plays it.
#[derive(Clone, Debug, PartialEq)]
pub struct Sequence {
    /// The folder that it was read from; empty where it was not.
    pub root: PathBuf,
    /// The IMU; recordings that only serve to build maps may have none.
    pub imu: Option<ImuSensor>,
    /// Its readings, strictly increasing in time and finite; empty without an IMU.
    pub imu_samples: Vec<ImuSample>,
    /// Geometry of the wheels, where there are any and it is known.
    pub wheels: Option<WheelSensor>,
    /// Their readings, strictly increasing in time; empty without wheels.
    pub wheel_readings: Vec<WheelReading>,
    /// The antenna of GNSS, where there is one and it is known.
    pub gnss: Option<GnssSensor>,
    /// Its positions, strictly increasing in time; empty without it.
    pub gnss_readings: Vec<GnssReading>,
    /// The cameras; frames refer to them by index.
    pub cameras: Vec<CameraSensor>,
    /// The frames of the cameras, strictly increasing in time.
    pub frames: Vec<Frame>,
    /// Ground truth, if there is any.
    pub groundtruth: Option<Vec<TruthRow>>,
    /// Poses to build a map from, if there are any.
    pub reference_poses: Option<Vec<ReferencePose>>,
}

impl Sequence {
    /// Whether any frame has an image.
    pub fn has_images(&self) -> bool {
        self.contents().images
    }

    /// Whether any frame has features for place recognition.
    pub fn has_features(&self) -> bool {
        self.contents().features
    }

    /// What the frames carry.
    pub fn contents(&self) -> Contents {
        let mut contents = Contents { frames: Some(0), ..Contents::default() };
        self.frames.iter().for_each(|frame| contents.add(frame));
        contents.gnss = !self.gnss_readings.is_empty();
        contents.wheels = (!self.wheel_readings.is_empty()).then_some(WheelReadings::Speeds);
        contents
    }

    /// Images of both cameras of a stereo pair, and of its first camera only; `None` without a stereo pair.
    pub(crate) fn stereo_pairs(&self) -> Option<PairCounts> {
        let mut counts: Option<PairCounts> = None;
        for group in camera_groups(&self.cameras) {
            let Some(second) = group.second else { continue };
            let counts = counts.get_or_insert_default();
            let has = |frame: &&Frame, camera| frame.images.contains_key(&camera);
            let firsts = || self.frames.iter().filter(|frame| has(frame, group.first));
            let pairs = firsts().filter(|frame| has(frame, second)).count();
            counts.pairs += pairs;
            counts.lone_first += firsts().count() - pairs;
        }
        counts
    }

    /// Calibration of the sensors.
    pub fn calibration(&self) -> SensorCalibration {
        SensorCalibration {
            imu: self.imu.clone(),
            cameras: self.cameras.clone(),
            wheels: self.wheels,
            gnss: self.gnss,
        }
    }

    /// Unit direction of gravity in the frame of the ground truth; see
    /// [`Recording::truth_gravity`](crate::Recording::truth_gravity).
    pub fn truth_gravity(&self) -> Option<Vector3<f64>> {
        let truth = self.groundtruth.iter().flatten().copied().map(Ok);
        let readings = self.imu_samples.iter().copied().map(Ok);
        // Rows in memory cannot fail.
        super::gravity::direction(Box::new(truth), Box::new(readings)).ok().flatten()
    }
}
