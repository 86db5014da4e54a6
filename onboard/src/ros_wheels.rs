//! Topics of a robot's wheels.

use crate::arguments::WheelArguments;
use sensors::ros::WheelJoints;
use sensors::{BaseKind, Encoder, WheelReadings};

/// The topic of a robot's wheels.
#[derive(Clone, Debug, PartialEq)]
pub enum RosWheels {
    /// `nav_msgs/Odometry`, of which the velocity is used, and what the base is.
    Base(String, BaseKind),
    /// `sensor_msgs/JointState`.
    Joints(String, RosJoints),
}

/// The joints of a robot's wheels.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RosJoints {
    /// What the base is.
    pub base: BaseKind,
    /// Its joints; without them those that are named so.
    pub joints: Option<WheelJoints>,
    /// The encoders of positions that are counts; without them they are angles.
    pub encoder: Option<Encoder>,
}

impl RosWheels {
    /// The topic that the switches name: of speeds where they state radii or joints, else of velocities of the base.
    ///
    /// # Errors
    /// Encoders that are none.
    pub(crate) fn of(arguments: &WheelArguments) -> anyhow::Result<Option<Self>> {
        let Some(topic) = arguments.wheel_topic.clone() else { return Ok(None) };
        let base = arguments.wheel_base.unwrap_or_default();
        let joints = WheelJoints::named(base, &arguments.wheel_joints);
        let is_joints = joints.is_some() || !arguments.wheel_radius.is_empty();
        Ok(Some(if is_joints {
            Self::Joints(topic, RosJoints { base, joints, encoder: arguments.encoder()? })
        } else {
            Self::Base(topic, base)
        }))
    }

    /// What its messages state.
    pub(crate) fn readings(&self) -> WheelReadings {
        match self {
            Self::Base(..) => WheelReadings::BaseVelocities,
            Self::Joints(..) => WheelReadings::Speeds,
        }
    }
}
