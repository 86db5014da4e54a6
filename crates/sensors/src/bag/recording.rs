//! A bag as a recording.

use super::accelerometer::interpolated;
use super::calibration;
use super::gnss_topic::GnssTopic;
use super::index::StampedTopic;
use super::messages;
use super::recorded_calibration::{imu_frame, static_transforms};
use super::rows::{Cameras, FrameRows, readings};
use super::topics::{BagSensors, wrong};
use super::wheel_topic::WheelTopic;
use crate::imu_intake::ImuIntake;
use crate::rows::Rows;
use crate::stored::Stored;
use crate::{
    CalibrationFiles, Frame, GnssReading, ImuSample, PairCounts, SensorCalibration, SequenceError,
    WheelReading, WheelReadings,
};
use bags::Bag;
use geometry::Pose;
use std::path::{Path, PathBuf};
use std::sync::Arc;

#[derive(Debug)]
pub(crate) struct BagRecording {
    bag: Arc<Bag>,
    imu: Option<Arc<StampedTopic>>,
    /// Where it has a topic of its own.
    accelerometer: Option<Arc<StampedTopic>>,
    wheels: Option<(Arc<StampedTopic>, WheelTopic)>,
    gnss: Option<(Arc<StampedTopic>, GnssTopic)>,
    cameras: Arc<Cameras>,
    imu_intake: ImuIntake,
    time_offset_ns: i64,
}

impl BagRecording {
    /// Opens a bag, finds its sensors and their calibration, and says what is damaged.
    pub(crate) fn open(
        path: &Path,
        files: &CalibrationFiles,
    ) -> Result<(Self, SensorCalibration), SequenceError> {
        let bag = Bag::open(path)?;
        for line in bag.notes().iter().chain(bag.damage()) {
            tracing::warn!("{line}");
        }
        let sensors = BagSensors::find(&bag, files)?;
        for note in &sensors.notes {
            tracing::warn!("{}: {note}", path.display());
        }
        let cameras = sensors.cameras.iter().map(|camera| camera.images);
        for topic in sensors.imu.into_iter().chain(sensors.accelerometer).chain(cameras) {
            if let Some(why) = messages::unreadable(&bag, topic) {
                return Err(wrong(&bag, format!("{} cannot be read: {why}", bag.topics()[topic].name)));
            }
        }
        // Files that are missing are found before all stamps are read.
        let wheels = WheelTopic::find(&bag, files)?;
        let of_wheels = wheels.as_ref().map(|(_, wheels)| wheels);
        let gnss = GnssTopic::find(&bag, files, calibration::stated_gnss(path, files)?)?;
        let of_gnss = gnss.as_ref().map(|(_, gnss)| gnss);
        let calibration = calibration::read(&bag, &sensors, of_wheels, of_gnss, files)?;
        let imu = sensors.imu.map(|topic| StampedTopic::read(&bag, topic, &[]));
        let steps = imu.as_ref().map_or(&[][..], |imu| &imu.steps);
        let accelerometer = sensors.accelerometer.map(|topic| StampedTopic::read(&bag, topic, steps));
        let of_imu = imu.iter().chain(&accelerometer);
        let stamped = |(topic, how)| (StampedTopic::read(&bag, topic, steps), how);
        let wheels = wheels.map(stamped);
        let gnss = gnss.map(|(topic, how)| (StampedTopic::read(&bag, topic, steps), how));
        let of_wheels = wheels.iter().map(|(topic, _)| topic);
        let camera = |camera: &super::BagCamera| StampedTopic::read(&bag, camera.images, steps);
        let cameras: Vec<Arc<StampedTopic>> = sensors.cameras.iter().map(camera).map(Arc::new).collect();
        if let Some(topic) = of_imu
            .chain(of_wheels)
            .chain(cameras.iter().map(Arc::as_ref))
            .find(|topic| topic.is_stopped(&bag))
        {
            let name = &bag.topics()[topic.topic].name;
            let problem = format!(
                "all messages of {name} have one time stamp in their headers: have the driver fill it in"
            );
            return Err(wrong(&bag, problem));
        }
        let time_offset_ns = calibration.time_offset_ns;
        let cameras_hz: Vec<f64> = cameras.iter().map(|camera| camera.rate_hz()).collect();
        let calibration = calibration.with_rates(imu.as_ref().map(StampedTopic::rate_hz), &cameras_hz)?;
        let recording = Self {
            bag: Arc::new(bag),
            imu: imu.filter(|_| calibration.imu.is_some()).map(Arc::new),
            accelerometer: accelerometer.map(Arc::new),
            wheels: wheels.map(|(topic, how)| (Arc::new(topic), how)),
            gnss: gnss.map(|(topic, how)| (Arc::new(topic), how)),
            cameras: Arc::new(Cameras::new(cameras, &calibration.cameras, files.pair_tolerance_ns())),
            imu_intake: ImuIntake::new(files.imu_units, calibration.imu.as_ref()),
            time_offset_ns,
        };
        Ok((recording, calibration))
    }
}

impl Stored for BagRecording {
    fn frames(&self) -> Result<Rows<'static, Frame>, SequenceError> {
        Ok(Box::new(FrameRows::new(&self.bag, &self.cameras, self.time_offset_ns)))
    }

    fn imu_samples(&self) -> Result<Rows<'static, ImuSample>, SequenceError> {
        let readings: Rows<'static, ImuSample> = match (&self.imu, &self.accelerometer) {
            (Some(topic), None) => Box::new(readings(&self.bag, topic)),
            (Some(gyroscope), Some(accelerometer)) => {
                Box::new(interpolated(&self.bag, gyroscope, accelerometer))
            }
            (None, _) => Box::new(std::iter::empty()),
        };
        let intake = self.imu_intake;
        Ok(Box::new(readings.map(move |reading| reading.map(|reading| intake.take(reading)))))
    }

    fn wheel_readings(&self) -> Result<Rows<'static, WheelReading>, SequenceError> {
        let Some((topic, how)) = &self.wheels else { return Ok(Box::new(std::iter::empty())) };
        Ok(Box::new(how.rows(&self.bag, topic)))
    }

    fn gnss_readings(&self) -> Result<Rows<'static, GnssReading>, SequenceError> {
        let Some((topic, how)) = &self.gnss else { return Ok(Box::new(std::iter::empty())) };
        Ok(Box::new(how.rows(&self.bag, topic)))
    }

    fn wheels_are(&self) -> WheelReadings {
        self.wheels.as_ref().map_or(WheelReadings::Speeds, |(_, how)| how.readings())
    }

    fn imu_from_base(&self, base: &str) -> Option<Pose> {
        let imu = imu_frame(&self.bag, self.imu.as_ref()?.topic);
        static_transforms(&self.bag).imu_from_base(&imu, base)
    }

    fn time_offset_ns(&self) -> i64 {
        self.time_offset_ns
    }

    fn stereo_pairs(&self) -> Option<PairCounts> {
        self.cameras.pairs
    }

    fn readings_path(&self) -> PathBuf {
        let topic = self.imu.as_ref().map_or("", |imu| &self.bag.topics()[imu.topic].name);
        format!("{}, {topic}", self.bag.path().display()).into()
    }
}
