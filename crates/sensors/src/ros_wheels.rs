//! Readings of wheels in messages of ROS.

use crate::WheelReading;
use ros_messages::nav_msgs::Odometry;
use ros_messages::sensor_msgs::JointState;

/// A base whose wheels forbid it does not move sideways faster, m/s: odometry of some drivers has rounding errors there.
const MAX_SIDEWAYS_M_S: f64 = 0.02;

/// The base moves sideways.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "the base moves sideways ({0:.2} m/s): drives that can (mecanum, omnidirectional) are not supported; leave --wheel-topic out"
)]
pub struct MovesSideways(pub f64);

/// The velocity of a base, as speeds of wheels of 1 m radius that are 1 m apart. The pose is not used.
///
/// # Errors
/// [`MovesSideways`].
///
/// ```
/// use ros_messages::nav_msgs::Odometry;
/// let mut message = Odometry::default();
/// message.twist.twist.linear.x = 2.0;
/// message.twist.twist.angular.z = 0.5;
/// let reading = sensors::ros::base_velocity(&message)?;
/// assert_eq!((reading.left, reading.right), (1.75, 2.25));
/// # Ok::<(), sensors::ros::MovesSideways>(())
/// ```
pub fn base_velocity(message: &Odometry) -> Result<WheelReading, MovesSideways> {
    let twist = &message.twist.twist;
    let sideways = twist.linear.y.abs();
    if sideways > MAX_SIDEWAYS_M_S {
        return Err(MovesSideways(sideways));
    }
    let stamp_ns = message.header.stamp.to_nanoseconds();
    Ok(WheelReading::of_base_velocity(stamp_ns, twist.linear.x, twist.angular.z))
}

/// The joints of the left and of the right wheels.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WheelJoints {
    left: Vec<String>,
    right: Vec<String>,
}

impl WheelJoints {
    /// One wheel on each side.
    pub fn named([left, right]: [String; 2]) -> Self {
        Self { left: vec![left], right: vec![right] }
    }

    /// Those among some joints that are named wheel, and left or right; `None` where a side has none.
    ///
    /// ```
    /// use sensors::ros::WheelJoints;
    /// let names = ["arm_left", "wheel_left_joint", "wheel_right_joint"].map(String::from);
    /// let [_, left, right] = names.clone();
    /// assert_eq!(WheelJoints::among(&names), Some(WheelJoints::named([left, right])));
    /// assert_eq!(WheelJoints::among(&names[..2]), None);
    /// ```
    pub fn among(names: &[String]) -> Option<Self> {
        let of_side = |side: &str| -> Vec<String> {
            let is_of_side = |name: &&String| {
                let name = name.to_lowercase();
                name.contains("wheel") && name.contains(side)
            };
            names.iter().filter(is_of_side).cloned().collect()
        };
        let (left, right) = (of_side("left"), of_side("right"));
        (!left.is_empty() && !right.is_empty()).then_some(Self { left, right })
    }

    /// All of them.
    pub fn names(&self) -> impl Iterator<Item = &String> {
        self.left.iter().chain(&self.right)
    }

    /// The speeds in a message, of several wheels on a side their mean: they turn together. `None` where one is missing.
    pub fn reading(&self, message: &JointState) -> Option<WheelReading> {
        let speed = |joint: &String| {
            let index = message.name.iter().position(|name| name == joint)?;
            message.velocity.get(index).copied()
        };
        let mean = |joints: &[String]| {
            let speeds: Option<Vec<f64>> = joints.iter().map(speed).collect();
            speeds.map(|speeds| speeds.iter().sum::<f64>() / speeds.len() as f64)
        };
        let stamp_ns = message.header.stamp.to_nanoseconds();
        Some(WheelReading { stamp_ns, left: mean(&self.left)?, right: mean(&self.right)? })
    }
}
