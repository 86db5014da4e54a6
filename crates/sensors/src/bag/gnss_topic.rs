//! GNSS of a bag.

use super::index::{Stamped, StampedTopic};
use super::messages;
use super::recorded_calibration::{self, imu_frame, static_transforms};
use super::rows::Values;
use super::topics::{NAV_SAT_FIX, POSITION, named, wrong};
use crate::gnss_intake::GnssIntake;
use crate::ros_gnss::{GNSS_TOPIC, position_of_message, satellite_position};
use crate::{CalibrationFiles, GnssReading, GnssSensor, SequenceError};
use bags::Bag;
use ros_messages::geometry_msgs::PoseWithCovarianceStamped;
use ros_messages::sensor_msgs::NavSatFix;
use std::sync::Arc;

/// How positions are read from a topic.
#[derive(Clone, Debug)]
pub(super) struct GnssTopic {
    /// Frame of the antenna; `None` of positions in the frame of the map, which Driftless recorded with the antenna.
    frame: Option<String>,
    /// Whether the sensor has the antenna, by a file or the recording of Driftless; else `/tf_static` may.
    has_antenna: bool,
    sensor: GnssSensor,
}

impl GnssTopic {
    /// Finds the topic that is named, else that of a recording of Driftless.
    ///
    /// # Arguments
    /// * `stated`: as a `sensor.yaml` states it; the origin of `files` comes first.
    ///
    /// # Errors
    /// [`SequenceError::Topics`]: it is not there, of another type, has no position, or the origin is not known.
    pub(super) fn find(
        bag: &Bag,
        files: &CalibrationFiles,
        stated: Option<GnssSensor>,
    ) -> Result<Option<(usize, Self)>, SequenceError> {
        let Some(name) = &files.gnss_topic else { return Self::recorded(bag) };
        let topic = named(bag, name, "--gnss-topic", &[NAV_SAT_FIX])?;
        if let Some(why) = messages::unreadable(bag, topic) {
            return Err(wrong(bag, format!("{name} cannot be read: {why}")));
        }
        let sensor = stated.unwrap_or_default();
        let Some(origin) = files.gnss_origin.or(sensor.origin) else {
            return Err(wrong(
                bag,
                format!(
                    "{name}: the origin of the frame is not known: give --gnss-origin, or origin in mav0/gnss0/sensor.yaml of the folder \
                     of --calibration"
                ),
            ));
        };
        let sensor = GnssSensor { origin: Some(origin), ..sensor };
        let intake = GnssIntake::new(&sensor);
        let recorded = bag.topics()[topic].messages.iter();
        let mut found = recorded.filter_map(|message| {
            let message: NavSatFix = messages::read(bag, topic, message.place).ok()?;
            satellite_position(&message).is_ok().then_some(message)
        });
        let Some(first) = found.next() else {
            return Err(wrong(bag, format!("{name} has no message with a position")));
        };
        // An origin elsewhere is a mistake in the switch, not in each message.
        if let Ok(position) = satellite_position(&first) {
            let taken = intake.take(position.stamp_ns, &position.geodetic, position.covariance);
            taken.map_err(|problem| wrong(bag, format!("{name}: {problem}")))?;
        }
        let frame = Some(first.header.frame_id);
        Ok(Some((topic, Self { frame, has_antenna: stated.is_some(), sensor })))
    }

    /// The positions that Driftless recorded.
    fn recorded(bag: &Bag) -> Result<Option<(usize, Self)>, SequenceError> {
        let is_it = |topic: &bags::Topic| topic.name == GNSS_TOPIC && topic.type_name == POSITION;
        let Some(topic) = bag.topics().iter().position(is_it) else { return Ok(None) };
        let sensor = recorded_calibration::gnss(bag)?;
        Ok(sensor.map(|sensor| (topic, Self { frame: None, has_antenna: true, sensor })))
    }

    /// The antenna, where a file or `/tf_static` says where it is.
    ///
    /// # Arguments
    /// * `imu`: topic of the IMU.
    pub(super) fn calibration(&self, bag: &Bag, imu: Option<usize>) -> Option<GnssSensor> {
        let Some(frame) = self.frame.as_ref().filter(|_| !self.has_antenna) else { return Some(self.sensor) };
        let imu_from_antenna = static_transforms(bag).between(&imu_frame(bag, imu?), frame)?;
        Some(GnssSensor { antenna_in_imu: imu_from_antenna.translation, ..self.sensor })
    }

    /// The positions of a topic that was found; messages without one are left out.
    pub(super) fn rows(
        &self,
        bag: &Arc<Bag>,
        topic: &Arc<StampedTopic>,
    ) -> impl Iterator<Item = Result<GnssReading, SequenceError>> + use<> {
        let (intake, is_recorded) = (GnssIntake::new(&self.sensor), self.frame.is_none());
        let values = Values::new(bag, topic, move |bag: &Bag, topic, message: Stamped| {
            if is_recorded {
                let message = messages::read::<PoseWithCovarianceStamped>(bag, topic, message.place).ok()?;
                return position_of_message(&message);
            }
            let message = messages::read::<NavSatFix>(bag, topic, message.place).ok()?;
            let position = satellite_position(&message).ok()?;
            intake.take(position.stamp_ns, &position.geodetic, position.covariance).ok()
        });
        values.map(|(stamp_ns, reading)| Ok(GnssReading { stamp_ns, ..reading }))
    }
}
