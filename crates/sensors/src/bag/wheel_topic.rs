//! The wheels of a bag: the speeds of joints, or the velocity of the base.

use super::index::{Stamped, StampedTopic};
use super::messages;
use super::recorded_calibration::imu_frame;
use super::rows::Values;
use super::static_transforms::StaticTransforms;
use super::topics::{JOINT_STATE, ODOMETRY, named, wrong};
use crate::{CalibrationFiles, SequenceError, WheelReading, WheelReadings, WheelSensor};
use bags::Bag;
use ros_messages::nav_msgs::Odometry;
use ros_messages::sensor_msgs::JointState;
use std::sync::Arc;

/// A base whose wheels forbid it does not move sideways faster, m/s: odometry of some drivers has rounding errors there.
const MAX_SIDEWAYS_M_S: f64 = 0.02;
/// So many messages are looked at for what a topic has.
const LOOKED_AT: usize = 50;

/// How the wheels are read from a topic.
#[derive(Clone, Debug)]
pub(super) enum WheelTopic {
    /// `sensor_msgs/JointState`: the joints of the left wheels, and of the right ones.
    Joints([Vec<String>; 2]),
    /// `nav_msgs/Odometry`, and the frame whose velocity it is.
    Base(String),
}

impl WheelTopic {
    /// Finds the topic that is named.
    ///
    /// # Errors
    /// [`SequenceError::Topics`]: it is not there, of another type, has no joints of wheels, or a base that moves sideways.
    pub(super) fn find(bag: &Bag, files: &CalibrationFiles) -> Result<Option<(usize, Self)>, SequenceError> {
        let Some(name) = &files.wheel_topic else { return Ok(None) };
        let topic = named(bag, name, "--wheel-topic", &[JOINT_STATE, ODOMETRY])?;
        if let Some(why) = messages::unreadable(bag, topic) {
            return Err(wrong(bag, format!("{name} cannot be read: {why}")));
        }
        let is_base = bag.topics()[topic].type_name == ODOMETRY;
        let found = if is_base { base(bag, topic, name)? } else { joints(bag, topic, files, name)? };
        Ok(Some((topic, found)))
    }

    /// What the readings are.
    pub(super) fn readings(&self) -> WheelReadings {
        match self {
            Self::Joints(_) => WheelReadings::Speeds,
            Self::Base(_) => WheelReadings::BaseVelocities,
        }
    }

    /// The geometry of the wheels, where the bag has it.
    ///
    /// # Arguments
    /// * `imu`: topic of the IMU.
    pub(super) fn calibration(&self, bag: &Bag, imu: Option<usize>) -> Option<WheelSensor> {
        let Self::Base(base) = self else { return None };
        let imu_from_base = StaticTransforms::read(bag).between(&imu_frame(bag, imu?), base)?;
        Some(WheelSensor::of_base_velocity(imu_from_base))
    }

    /// The readings of a topic that was found.
    pub(super) fn rows(
        &self,
        bag: &Arc<Bag>,
        topic: &Arc<StampedTopic>,
    ) -> impl Iterator<Item = Result<WheelReading, SequenceError>> + use<> {
        let how = self.clone();
        let values = Values::new(bag, topic, move |bag: &Bag, topic, message: Stamped| {
            how.reading(bag, topic, message).filter(WheelReading::is_finite)
        });
        values.map(|(_, reading)| Ok(reading))
    }

    fn reading(&self, bag: &Bag, topic: usize, message: Stamped) -> Option<WheelReading> {
        let Stamped { stamp_ns, place } = message;
        match self {
            Self::Base(_) => {
                let Odometry { twist, .. } = messages::read(bag, topic, place).ok()?;
                let (ahead, turn) = (twist.twist.linear.x, twist.twist.angular.z);
                Some(WheelReading::of_base_velocity(stamp_ns, ahead, turn))
            }
            Self::Joints(sides) => {
                let JointState { name, velocity, .. } = messages::read(bag, topic, place).ok()?;
                let speed = |joint: &String| {
                    let index = name.iter().position(|name| name == joint)?;
                    velocity.get(index).copied()
                };
                // Wheels of one side turn together.
                let mean = |joints: &[String]| {
                    let speeds: Option<Vec<f64>> = joints.iter().map(speed).collect();
                    speeds.map(|speeds| speeds.iter().sum::<f64>() / speeds.len() as f64)
                };
                let [left, right] = sides.each_ref().map(|joints| mean(joints));
                Some(WheelReading { stamp_ns, left: left?, right: right? })
            }
        }
    }
}

/// The readable messages among the first of a topic.
fn first<M: ros_messages::RosMessage>(bag: &Bag, topic: usize) -> impl Iterator<Item = M> {
    let looked_at = bag.topics()[topic].messages.iter().take(LOOKED_AT);
    looked_at.filter_map(move |message| messages::read(bag, topic, message.place).ok())
}

fn base(bag: &Bag, topic: usize, name: &str) -> Result<WheelTopic, SequenceError> {
    let step = (bag.topics()[topic].messages.len() / LOOKED_AT).max(1);
    let looked_at = bag.topics()[topic].messages.iter().step_by(step);
    let read = |message: &bags::StoredMessage| messages::read::<Odometry>(bag, topic, message.place).ok();
    let fastest =
        looked_at.filter_map(read).map(|message| message.twist.twist.linear.y.abs()).fold(0.0, f64::max);
    if fastest > MAX_SIDEWAYS_M_S {
        let problem = format!(
            "--wheel-topic {name} has a base that moves sideways ({fastest:.2} m/s): drives that can (mecanum, omnidirectional) are \
             not supported; leave it out"
        );
        return Err(wrong(bag, problem));
    }
    let frame = first::<Odometry>(bag, topic).next().map(|message| message.child_frame_id);
    Ok(WheelTopic::Base(frame.unwrap_or_default()))
}

fn joints(
    bag: &Bag,
    topic: usize,
    files: &CalibrationFiles,
    name: &str,
) -> Result<WheelTopic, SequenceError> {
    let mut names: Vec<String> = first::<JointState>(bag, topic).flat_map(|message| message.name).collect();
    names.sort_unstable();
    names.dedup();
    let sides = match &files.wheel_joints {
        Some(joints) => joints.clone().map(|joint| vec![joint]),
        None => ["left", "right"].map(|side| {
            let of_side = |name: &&String| {
                let name = name.to_lowercase();
                name.contains("wheel") && name.contains(side)
            };
            names.iter().filter(of_side).cloned().collect()
        }),
    };
    let is_there = |side: &Vec<String>| !side.is_empty() && side.iter().all(|joint| names.contains(joint));
    if sides.iter().all(is_there) {
        return Ok(WheelTopic::Joints(sides));
    }
    let problem = format!(
        "the joints of the left and the right wheel are not known: name them with --wheel-joints LEFT,RIGHT; {name} has: {}",
        names.join(", ")
    );
    Err(wrong(bag, problem))
}
