//! The wheels of a bag: the speeds of joints, or the velocity of the base.

use super::index::{Stamped, StampedTopic};
use super::messages;
use super::recorded_calibration::{self, imu_frame, static_transforms};
use super::rows::Values;
use super::topics::{JOINT_STATE, ODOMETRY, named, wrong};
use crate::ros_wheels::{JointReader, WHEEL_TOPIC, WheelJoints, base_velocity};
use crate::{BaseKind, CalibrationFiles, SequenceError, WheelReading, WheelReadings, WheelSensor};
use bags::Bag;
use ros_messages::RosMessage;
use ros_messages::nav_msgs::Odometry;
use ros_messages::sensor_msgs::JointState;
use std::sync::Arc;

/// So many messages of a topic are looked at for what it has.
const LOOKED_AT: usize = 50;

/// How the wheels are read from a topic.
#[derive(Clone, Debug)]
pub(super) enum WheelTopic {
    /// `sensor_msgs/JointState`.
    Joints(JointReader),
    /// The same, recorded by Driftless, with the geometry.
    Recorded(JointReader, WheelSensor),
    /// `nav_msgs/Odometry`: what the base is, and the frame whose velocity it is.
    Base(BaseKind, String),
}

impl WheelTopic {
    /// Finds the topic that is named, else that of a recording of Driftless.
    ///
    /// # Errors
    /// [`SequenceError::Topics`]: it is not there, of another type, has no joints of wheels, or a base that moves sideways.
    pub(super) fn find(bag: &Bag, files: &CalibrationFiles) -> Result<Option<(usize, Self)>, SequenceError> {
        let Some(name) = &files.wheel_topic else { return Self::recorded(bag) };
        let topic = named(bag, name, "--wheel-topic", &[JOINT_STATE, ODOMETRY])?;
        if let Some(why) = messages::unreadable(bag, topic) {
            return Err(wrong(bag, format!("{name} cannot be read: {why}")));
        }
        let is_base = bag.topics()[topic].type_name == ODOMETRY;
        let found = if is_base { base(bag, topic, files)? } else { joints(bag, topic, files)? };
        Ok(Some((topic, found)))
    }

    /// The wheels that Driftless recorded.
    fn recorded(bag: &Bag) -> Result<Option<(usize, Self)>, SequenceError> {
        let is_it = |topic: &bags::Topic| topic.name == WHEEL_TOPIC && topic.type_name == JOINT_STATE;
        let Some(topic) = bag.topics().iter().position(is_it) else { return Ok(None) };
        let Some(wheels) = recorded_calibration::wheels(bag)? else { return Ok(None) };
        let kind = wheels.base.kind();
        let names: Vec<String> = kind.columns().iter().map(|&name| name.to_owned()).collect();
        let reader = JointReader::new(kind, WheelJoints::named(kind, &names), None);
        Ok(Some((topic, Self::Recorded(reader, wheels))))
    }

    /// What the readings are.
    pub(super) fn readings(&self) -> WheelReadings {
        match self {
            Self::Joints(_) | Self::Recorded(..) => WheelReadings::Speeds,
            Self::Base(..) => WheelReadings::BaseVelocities,
        }
    }

    /// The geometry of the wheels, where the bag has it.
    ///
    /// # Arguments
    /// * `imu`: topic of the IMU.
    pub(super) fn calibration(&self, bag: &Bag, imu: Option<usize>) -> Option<WheelSensor> {
        let (kind, base) = match self {
            Self::Joints(_) => return None,
            Self::Recorded(_, wheels) => return Some(*wheels),
            Self::Base(kind, base) => (kind, base),
        };
        let imu_from_base = static_transforms(bag).between(&imu_frame(bag, imu?), base)?;
        Some(WheelSensor::of_base_velocity(*kind, imu_from_base))
    }

    /// The readings of a topic that was found.
    pub(super) fn rows(
        &self,
        bag: &Arc<Bag>,
        topic: &Arc<StampedTopic>,
    ) -> impl Iterator<Item = Result<WheelReading, SequenceError>> + use<> {
        let mut how = self.clone();
        let values = Values::new(bag, topic, move |bag: &Bag, topic, message: Stamped| {
            let place = message.place;
            let reading = match &mut how {
                Self::Joints(reader) | Self::Recorded(reader, _) => {
                    let joints = messages::read::<JointState>(bag, topic, place).ok()?;
                    // The first positions have no speed yet.
                    return Some(reader.reading(message.stamp_ns, &joints));
                }
                Self::Base(kind, _) => {
                    base_velocity(&messages::read::<Odometry>(bag, topic, place).ok()?, *kind).ok()?
                }
            };
            let reading = WheelReading { stamp_ns: message.stamp_ns, ..reading };
            reading.is_finite().then_some(Some(reading))
        });
        values.filter_map(|(_, reading)| reading.map(Ok))
    }
}

/// Some readable messages of a topic, from all over it.
fn samples<M: RosMessage>(bag: &Bag, topic: usize) -> impl Iterator<Item = M> {
    let recorded = &bag.topics()[topic].messages;
    let step = (recorded.len() / LOOKED_AT).max(1);
    recorded.iter().step_by(step).filter_map(move |message| messages::read(bag, topic, message.place).ok())
}

fn base(bag: &Bag, topic: usize, files: &CalibrationFiles) -> Result<WheelTopic, SequenceError> {
    let mut frame = String::new();
    let kind = files.wheel_base.unwrap_or_default();
    for message in samples::<Odometry>(bag, topic) {
        base_velocity(&message, kind)
            .map_err(|sideways| wrong(bag, format!("{}: {sideways}", bag.topics()[topic].name)))?;
        frame = message.child_frame_id;
    }
    Ok(WheelTopic::Base(kind, frame))
}

fn joints(bag: &Bag, topic: usize, files: &CalibrationFiles) -> Result<WheelTopic, SequenceError> {
    let mut names: Vec<String> = samples::<JointState>(bag, topic).flat_map(|message| message.name).collect();
    names.sort_unstable();
    names.dedup();
    let kind = files.wheel_base.unwrap_or_default();
    let joints = match files.wheel_joints.as_slice() {
        [] => WheelJoints::among(kind, &names),
        given => WheelJoints::named(kind, given),
    };
    let is_there = |joints: &WheelJoints| joints.names().all(|joint| names.contains(joint));
    let Some(joints) = joints.filter(is_there) else {
        let problem = format!(
            "the joints of the wheels are not known: name those of a {kind} base with --wheel-joints {}, or the base with --wheel-base; {} \
             has: {}",
            kind.columns().join(",").to_uppercase(),
            bag.topics()[topic].name,
            names.join(", ")
        );
        return Err(wrong(bag, problem));
    };
    Ok(WheelTopic::Joints(JointReader::new(kind, Some(joints), files.wheel_encoder)))
}
