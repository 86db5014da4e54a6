//! Readings of wheels and GNSS, as a robot with the calibration of the recording takes them in.

use super::SensorTopics;
use anyhow::Result;
use geometry::{EnuFrame, Geodetic};
use protocol::sensors::{GnssMessage, WheelMessage};
use sensors::{Contents, GnssReading, MAX_WHEELS, SensorCalibration, WheelReading, WheelReadings};

/// Publishes them, or warns once that they are not published.
pub(super) struct SideReadings {
    /// Numbers of a reading of the wheels; `None` where a robot reads others.
    columns: Option<usize>,
    /// Where positions are latitude, longitude and altitude.
    origin: Option<Geodetic>,
    has_warned_of_wheels: bool,
    has_warned_of_gnss: bool,
}

impl SideReadings {
    /// # Arguments
    /// * `calibration`: of the recording, which is that of the robot as well.
    pub(super) fn new(calibration: &SensorCalibration, contents: Contents) -> Self {
        let wheels = calibration.wheels.as_ref();
        let are_speeds = contents.wheels == Some(WheelReadings::Speeds)
            && wheels.is_none_or(|wheels| wheels.encoder.is_none());
        let columns = wheels.map_or(MAX_WHEELS, |wheels| wheels.base.kind().columns().len());
        Self {
            columns: are_speeds.then_some(columns),
            origin: calibration.gnss.and_then(|gnss| gnss.origin),
            has_warned_of_wheels: false,
            has_warned_of_gnss: false,
        }
    }

    /// Publishes a reading of the wheels.
    ///
    /// # Returns
    /// Whether it was published.
    pub(super) fn wheels(&mut self, topics: &dyn SensorTopics, reading: &WheelReading) -> Result<bool> {
        let is_published = match self.columns {
            Some(columns) => {
                let wheels = reading.values.iter().take(columns).copied().collect();
                topics.wheels(&WheelMessage { stamp_ns: reading.stamp_ns, wheels })?
            }
            None => false,
        };
        if !is_published && !std::mem::replace(&mut self.has_warned_of_wheels, true) {
            tracing::warn!(
                "the wheels of this recording are not published: only --as native has them, and no counts of encoders and no \
                 velocities of the base"
            );
        }
        Ok(is_published)
    }

    /// Publishes a position of GNSS.
    ///
    /// # Returns
    /// Whether it was published.
    pub(super) fn gnss(&mut self, topics: &dyn SensorTopics, reading: &GnssReading) -> Result<bool> {
        let position = match &self.origin {
            Some(origin) => {
                let found = EnuFrame::at(origin).geodetic(&reading.position);
                [found.latitude_deg, found.longitude_deg, found.altitude_m]
            }
            None => reading.position.into(),
        };
        let sigma = reading.covariance.diagonal().map(f64::sqrt);
        let message = GnssMessage { stamp_ns: reading.stamp_ns, position, sigma: Some(sigma.into()) };
        let is_published = topics.gnss(&message)?;
        if !is_published && !std::mem::replace(&mut self.has_warned_of_gnss, true) {
            tracing::warn!(
                "the positions of GNSS of this recording are not published: only --as native has them"
            );
        }
        Ok(is_published)
    }
}

#[cfg(test)]
mod tests {
    use super::super::play;
    use super::*;
    use nalgebra::{Matrix3, Vector3};
    use onboard::StopSignal;
    use sensors::{Frame, GnssSensor, ImuSample, Recording, Sequence};
    use std::cell::RefCell;
    use std::path::PathBuf;

    /// Keeps wheels and GNSS.
    #[derive(Default)]
    struct Kept {
        wheels: RefCell<Vec<WheelMessage>>,
        positions: RefCell<Vec<GnssMessage>>,
    }

    impl SensorTopics for Kept {
        fn are_heard(&self) -> Result<bool> {
            Ok(true)
        }

        fn why_unheard(&self) -> Result<String> {
            Ok(String::new())
        }

        fn reading(&self, _: &ImuSample) -> Result<()> {
            Ok(())
        }

        fn frame(&self, _: &Frame) -> Result<()> {
            Ok(())
        }

        fn wheels(&self, message: &WheelMessage) -> Result<bool> {
            self.wheels.borrow_mut().push(message.clone());
            Ok(true)
        }

        fn gnss(&self, message: &GnssMessage) -> Result<bool> {
            self.positions.borrow_mut().push(*message);
            Ok(true)
        }
    }

    #[test]
    fn wheels_and_gnss_are_played_in_the_form_that_the_robot_reads() {
        let imu = |stamp_ns| ImuSample {
            stamp_ns,
            gyroscope: Vector3::zeros(),
            accelerometer: Vector3::new(0.0, 0.0, 9.81),
        };
        let origin = Geodetic { latitude_deg: 48.0, longitude_deg: 11.0, altitude_m: 500.0 };
        let (position, covariance) = (Vector3::new(0.0, 0.0, 20.0), Matrix3::identity() * 4.0);
        let sequence = Sequence {
            root: PathBuf::new(),
            imu: None,
            imu_samples: vec![imu(0), imu(10_000_000)],
            wheels: None,
            wheel_readings: vec![WheelReading::new(4_000_000, [1.0, 2.0])],
            gnss: Some(GnssSensor { origin: Some(origin), ..GnssSensor::default() }),
            gnss_readings: vec![GnssReading { stamp_ns: 5_000_000, position, covariance }],
            cameras: Vec::new(),
            frames: Vec::new(),
            groundtruth: None,
            reference_poses: None,
        };
        let recording = Recording::from(&sequence);
        let topics = Kept::default();
        let mut source = recording.source().unwrap();
        let published = play(&topics, &mut source, 1000.0, 0, &StopSignal::default()).unwrap();
        assert_eq!((published.readings, published.wheels, published.positions), (2, 1, 1));
        let wheels = topics.wheels.into_inner();
        assert_eq!((wheels[0].stamp_ns, &wheels[0].wheels[..2]), (4_000_000, &[1.0, 2.0][..]));
        let positions = topics.positions.into_inner();
        assert!((positions[0].position[2] - 520.0).abs() < 1e-6, "{positions:?}");
        assert_eq!(positions[0].sigma, Some([2.0; 3]));
    }
}
