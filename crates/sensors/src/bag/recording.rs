//! A bag as a recording.

use super::calibration;
use super::rows::{FrameRows, LeftOut, readings};
use super::topics::BagSensors;
use crate::rows::Rows;
use crate::stored::Stored;
use crate::{CalibrationFiles, Frame, ImuSample, SensorCalibration, SequenceError};
use bags::Bag;
use std::path::{Path, PathBuf};
use std::sync::Arc;

#[derive(Debug)]
pub(crate) struct BagRecording {
    bag: Arc<Bag>,
    imu: Option<(usize, Arc<LeftOut>)>,
    cameras: Vec<(usize, Arc<LeftOut>)>,
    time_offset_ns: i64,
}

impl BagRecording {
    /// Opens a bag, finds its sensors and their calibration, and says what is damaged.
    pub(crate) fn open(
        path: &Path,
        files: &CalibrationFiles,
    ) -> Result<(Self, SensorCalibration), SequenceError> {
        let bag = Bag::open(path)?;
        for line in bag.damage() {
            tracing::warn!("{line}");
        }
        let sensors = BagSensors::find(&bag, files)?;
        let calibration = calibration::read(&bag, &sensors, files)?;
        let topic = |index: usize| (index, Arc::default());
        let recording = Self {
            bag: Arc::new(bag),
            imu: sensors.imu.filter(|_| calibration.sensors.imu.is_some()).map(topic),
            cameras: sensors.cameras.iter().map(|camera| topic(camera.images)).collect(),
            time_offset_ns: calibration.time_offset_ns,
        };
        Ok((recording, calibration.sensors))
    }
}

impl Stored for BagRecording {
    fn frames(&self) -> Result<Rows<'static, Frame>, SequenceError> {
        Ok(Box::new(FrameRows::new(&self.bag, &self.cameras, self.time_offset_ns)))
    }

    fn imu_samples(&self) -> Result<Rows<'static, ImuSample>, SequenceError> {
        Ok(match &self.imu {
            Some((topic, left_out)) => Box::new(readings(&self.bag, *topic, left_out)),
            None => Box::new(std::iter::empty()),
        })
    }

    fn time_offset_ns(&self) -> i64 {
        self.time_offset_ns
    }

    fn readings_path(&self) -> PathBuf {
        let topic = self.imu.as_ref().map_or("", |(topic, _)| &self.bag.topics()[*topic].name);
        format!("{}, {topic}", self.bag.path().display()).into()
    }
}
