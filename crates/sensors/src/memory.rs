//! A recording in memory.

use super::{
    CameraSensor, Contents, Frame, ImuSample, ImuSensor, PairCounts, ReferencePose, SensorCalibration,
    TruthRow, WheelReading, WheelReadings, WheelSensor,
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
    /// One camera, or the two of a stereo pair.
    pub cameras: Vec<CameraSensor>,
    /// The frames of the cameras, strictly increasing in time.
    pub frames: Vec<Frame>,
    /// Ground truth, if there is any.
    pub groundtruth: Option<Vec<TruthRow>>,
    /// Poses to build a map from, if there are any.
    pub reference_poses: Option<Vec<ReferencePose>>,
}

impl Sequence {
    /// Whether camera 0 has an image of any frame.
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
        contents.wheels = (!self.wheel_readings.is_empty()).then_some(WheelReadings::Speeds);
        contents
    }

    /// Frames with images of both cameras, and with one of camera 0 only; `None` for one camera.
    pub(crate) fn stereo_pairs(&self) -> Option<PairCounts> {
        let images = || self.frames.iter().map(|frame| frame.images.each_ref().map(Option::is_some));
        let count = |wanted| images().filter(|found| *found == wanted).count();
        let (pairs, lone_first) = (count([true, true]), count([true, false]));
        (self.cameras.len() > 1).then(|| PairCounts { pairs, lone_first, ..PairCounts::default() })
    }

    /// Calibration of the sensors.
    pub fn calibration(&self) -> SensorCalibration {
        SensorCalibration { imu: self.imu.clone(), cameras: self.cameras.clone(), wheels: self.wheels }
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
