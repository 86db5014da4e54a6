//! Topics of a robot's wheels.

use crate::arguments::WheelArguments;
use sensors::ros::WheelJoints;
use sensors::{BaseKind, Encoder, WheelReadings, WheelSensor};

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
    /// The topic that the switches name: of speeds where they state radii or joints, else of velocities of the base. Base and encoders
    /// are those of the switches, else of the calibration.
    ///
    /// # Errors
    /// Joints or encoders that are none of such a base.
    pub(crate) fn of(
        arguments: &WheelArguments,
        calibrated: Option<&WheelSensor>,
    ) -> anyhow::Result<Option<Self>> {
        let Some(topic) = arguments.wheel_topic.clone() else { return Ok(None) };
        let stated = calibrated.map(|wheels| wheels.base.kind());
        let base = arguments.wheel_base.or(stated).unwrap_or_default();
        arguments.check_joints(base)?;
        let encoder = arguments.encoder()?.or_else(|| calibrated?.encoder);
        let joints = WheelJoints::named(base, &arguments.wheel_joints);
        let is_joints = joints.is_some() || !arguments.wheel_radius.is_empty();
        Ok(Some(if is_joints {
            Self::Joints(topic, RosJoints { base, joints, encoder })
        } else {
            Self::Base(topic, base)
        }))
    }

    /// The wheels as the readings of the topic have them: velocities of the base are those of wheels of 1 m radius.
    pub(crate) fn sensor(&self, calibrated: &WheelSensor) -> WheelSensor {
        match self {
            Self::Base(_, kind) => WheelSensor::of_base_velocity(*kind, calibrated.imu_from_base),
            Self::Joints(..) => *calibrated,
        }
    }

    /// What its messages state.
    pub(crate) fn readings(&self) -> WheelReadings {
        match self {
            Self::Base(..) => WheelReadings::BaseVelocities,
            Self::Joints(..) => WheelReadings::Speeds,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::Pose;
    use sensors::WheelBase;

    fn given(joints: &[&str]) -> WheelArguments {
        WheelArguments {
            wheel_topic: Some("/joint_states".to_owned()),
            wheel_joints: joints.iter().map(|&joint| joint.to_owned()).collect(),
            ..WheelArguments::default()
        }
    }

    #[test]
    fn what_the_switches_leave_out_is_as_in_the_calibration() {
        let encoder = Encoder::new(4096.0, 16).unwrap();
        let base = WheelBase::new(BaseKind::Mecanum, 0.1, 0.4);
        let calibrated = WheelSensor { encoder: Some(encoder), ..WheelSensor::new(base, Pose::identity()) };
        let four = given(&["fl", "fr", "rl", "rr"]);
        let Some(RosWheels::Joints(_, joints)) = RosWheels::of(&four, Some(&calibrated)).unwrap() else {
            panic!("joints")
        };
        assert_eq!((joints.base, joints.encoder), (BaseKind::Mecanum, Some(encoder)));
        assert!(joints.joints.is_some());
        let velocities = RosWheels::of(&given(&[]), Some(&calibrated)).unwrap().unwrap();
        assert_eq!(velocities, RosWheels::Base("/joint_states".to_owned(), BaseKind::Mecanum));
        assert_eq!(velocities.sensor(&calibrated).base, WheelBase::new(BaseKind::Mecanum, 1.0, 1.0));
        let switched = WheelArguments { wheel_base: Some(BaseKind::Differential), ..given(&["l", "r"]) };
        let switched = RosWheels::of(&switched, Some(&calibrated)).unwrap();
        assert!(
            matches!(switched, Some(RosWheels::Joints(_, joints)) if joints.base == BaseKind::Differential)
        );
    }

    #[test]
    fn joints_must_be_as_many_as_the_base_has() {
        let error = RosWheels::of(&given(&["a", "b", "c"]), None).unwrap_err().to_string();
        assert!(error.contains("names 3 joints, but a differential base has 2"), "{error}");
        assert!(RosWheels::of(&given(&["a", "b"]), None).is_ok());
    }
}
