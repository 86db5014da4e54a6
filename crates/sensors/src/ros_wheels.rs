//! Readings of wheels in messages of ROS.

use crate::{BaseKind, Encoder, WheelReading};
use ros_messages::nav_msgs::Odometry;
use ros_messages::sensor_msgs::JointState;
use ros_messages::std_msgs::Header;
use types::EncoderCounts;

/// A base whose wheels forbid it does not move sideways faster, m/s: odometry of some drivers has rounding errors there.
const MAX_SIDEWAYS_M_S: f64 = 0.02;

/// The base moves sideways.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "the base moves sideways ({0:.2} m/s): give --wheel-base mecanum (or omni3, omni4) where it can, else leave --wheel-topic out"
)]
pub struct MovesSideways(pub f64);

/// The velocity of a base, as speeds of the wheels of [`WheelReading::of_base_velocity`]. The pose is not used.
///
/// # Errors
/// [`MovesSideways`], where the base cannot.
///
/// ```
/// use ros_messages::nav_msgs::Odometry;
/// use sensors::BaseKind;
/// let mut message = Odometry::default();
/// message.twist.twist.linear.x = 2.0;
/// message.twist.twist.angular.z = 0.5;
/// let reading = sensors::ros::base_velocity(&message, BaseKind::Differential)?;
/// assert_eq!(reading.values[..2], [1.75, 2.25]);
/// # Ok::<(), sensors::ros::MovesSideways>(())
/// ```
pub fn base_velocity(message: &Odometry, kind: BaseKind) -> Result<WheelReading, MovesSideways> {
    let twist = &message.twist.twist;
    let sideways = twist.linear.y.abs();
    if sideways > MAX_SIDEWAYS_M_S && !kind.moves_sideways() {
        return Err(MovesSideways(sideways));
    }
    let stamp_ns = message.header.stamp.to_nanoseconds();
    let velocity = [twist.linear.x, twist.linear.y];
    Ok(WheelReading::of_base_velocity(kind, stamp_ns, velocity, twist.angular.z))
}

/// The topic of the wheels of a recording of Driftless.
pub const WHEEL_TOPIC: &str = "/wheels";

/// A reading as a message, whose joints have the names of [`BaseKind::columns`]; `None` for a time that ROS cannot write.
///
/// # Arguments
/// * `frame`: name of the base's frame.
pub fn wheel_message(reading: &WheelReading, kind: BaseKind, frame: &str) -> Option<JointState> {
    let (columns, wheels) = (kind.columns(), kind.wheels());
    let part = |of_wheels: bool| {
        let values = reading.values.iter().enumerate().take(columns.len());
        values.map(|(index, value)| if (index < wheels) == of_wheels { *value } else { f64::NAN }).collect()
    };
    Some(JointState {
        header: Header::new(reading.stamp_ns, frame)?,
        name: columns.iter().map(|&name| name.to_owned()).collect(),
        position: part(false),
        velocity: part(true),
        effort: Vec::new(),
    })
}

/// The joints of a base's wheels, and of its steering.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WheelJoints {
    base: BaseKind,
    /// Of each number of a reading; of several joints the mean counts.
    columns: Vec<Vec<String>>,
}

impl WheelJoints {
    /// One joint for each of [`BaseKind::columns`]; `None` where there are more or fewer.
    pub fn named(base: BaseKind, joints: &[String]) -> Option<Self> {
        let columns: Vec<Vec<String>> = joints.iter().map(|joint| vec![joint.clone()]).collect();
        (columns.len() == base.columns().len()).then_some(Self { base, columns })
    }

    /// Those among some joints whose names say what they are; `None` where one has none.
    ///
    /// | base | names with |
    /// |---|---|
    /// | differential | `wheel`, and `left` or `right` |
    /// | Ackermann | `wheel` and `rear` (`back`), both sides; `steer` |
    /// | mecanum | `wheel`, `front` or `rear` (`back`), and `left` or `right`; or `fl`, `fr`, `rl` (`bl`), `rr` (`br`) |
    /// | omni | none: they have no order |
    ///
    /// ```
    /// use sensors::{BaseKind, ros::WheelJoints};
    /// let names = ["arm_left", "wheel_left_joint", "wheel_right_joint"].map(String::from);
    /// let base = BaseKind::Differential;
    /// assert_eq!(WheelJoints::among(base, &names), WheelJoints::named(base, &names[1..]));
    /// assert_eq!(WheelJoints::among(base, &names[..2]), None);
    /// ```
    pub fn among(base: BaseKind, names: &[String]) -> Option<Self> {
        let with = |is_meant: &dyn Fn(&JointName) -> bool| -> Vec<String> {
            names.iter().filter(|name| is_meant(&JointName::new(name))).cloned().collect()
        };
        let corner = |front: bool, side: &str| {
            let ends: [&str; 2] = if front { ["front", "front"] } else { ["rear", "back"] };
            with(&|name| name.is_corner(&ends, side))
        };
        let columns = match base {
            BaseKind::Differential => {
                ["left", "right"].map(|side| with(&|name| name.has("wheel") && name.has(side))).to_vec()
            }
            BaseKind::Ackermann => vec![
                with(&|name| {
                    name.has("wheel") && (name.has("rear") || name.has("back")) && !name.has("steer")
                }),
                with(&|name| name.has("steer")),
            ],
            BaseKind::Mecanum => {
                vec![
                    corner(true, "left"),
                    corner(true, "right"),
                    corner(false, "left"),
                    corner(false, "right"),
                ]
            }
            _ => return None,
        };
        columns.iter().all(|joints| !joints.is_empty()).then_some(Self { base, columns })
    }

    /// All of them.
    pub fn names(&self) -> impl Iterator<Item = &String> {
        self.columns.iter().flatten()
    }

    /// The mean of some joints' numbers; `None` where one is missing or not finite.
    fn mean(joints: &[String], message: &JointState, numbers: &[f64]) -> Option<f64> {
        let number = |joint: &String| {
            let index = message.name.iter().position(|name| name == joint)?;
            numbers.get(index).copied().filter(|number| number.is_finite())
        };
        let numbers = joints.iter().map(number).collect::<Option<Vec<f64>>>()?;
        Some(numbers.iter().sum::<f64>() / numbers.len() as f64)
    }

    /// The numbers of a reading, of which those of the wheels are speeds, or positions; the angle of a steering is its position.
    fn values(&self, message: &JointState, wheels: &[f64]) -> Option<Vec<f64>> {
        let columns = self.columns.iter().enumerate();
        let value = |(index, joints): (usize, &Vec<String>)| {
            let numbers = if index < self.base.wheels() { wheels } else { &message.position };
            Self::mean(joints, message, numbers)
        };
        columns.map(value).collect()
    }
}

/// What the name of a joint says.
struct JointName {
    text: String,
}

impl JointName {
    fn new(name: &str) -> Self {
        Self { text: name.to_lowercase() }
    }

    fn has(&self, word: &str) -> bool {
        self.text.contains(word)
    }

    /// Whether it is a wheel of a corner, written in full or by two initials.
    fn is_corner(&self, ends: &[&str], side: &str) -> bool {
        let initials = |end: &str| [&end[..1], &side[..1]].concat();
        let mut words = self.text.split(|letter: char| !letter.is_alphanumeric());
        let is_short = words.any(|word| ends.iter().any(|end| word == initials(end)));
        is_short || (self.has("wheel") && self.has(side) && ends.iter().any(|end| self.has(end)))
    }
}

/// Turns messages of joints into readings: by the velocities of the wheels, or by their positions where they have none.
#[derive(Clone, Debug)]
pub struct JointReader {
    base: BaseKind,
    joints: Option<WheelJoints>,
    counts: EncoderCounts,
}

impl JointReader {
    /// # Arguments
    /// * `joints`: without them those that are named so in each message.
    /// * `encoder`: of positions that are counts; without it they are angles in rad.
    pub fn new(base: BaseKind, joints: Option<WheelJoints>, encoder: Option<Encoder>) -> Self {
        let encoder = encoder.unwrap_or_else(Encoder::of_angles);
        Self { base, joints, counts: EncoderCounts::new(encoder, base.wheels()) }
    }

    /// The reading of a message; `None` where it has no such joints, and of the first positions.
    ///
    /// # Arguments
    /// * `stamp_ns`: of the message, nanoseconds.
    ///
    /// ```
    /// use ros_messages::sensor_msgs::JointState;
    /// use sensors::{BaseKind, ros::JointReader};
    /// let mut reader = JointReader::new(BaseKind::Differential, None, None);
    /// let name = vec!["left_wheel".to_owned(), "right_wheel".to_owned()];
    /// let mut message = JointState { name, position: vec![3.1, 0.5], ..JointState::default() };
    /// assert!(reader.reading(0, &message).is_none());
    /// message.position = vec![-3.1, 0.4]; // the left one wrapped around
    /// let reading = reader.reading(100_000_000, &message).unwrap();
    /// assert_eq!(reading.stamp_ns, 50_000_000);
    /// assert!((reading.values[0] - 0.832).abs() < 1e-3 && (reading.values[1] + 1.0).abs() < 1e-9);
    /// message.velocity = vec![0.8, -1.0];
    /// assert_eq!(reader.reading(200_000_000, &message).unwrap().values[..2], [0.8, -1.0]);
    /// ```
    pub fn reading(&mut self, stamp_ns: i64, message: &JointState) -> Option<WheelReading> {
        let found = if self.joints.is_none() { WheelJoints::among(self.base, &message.name) } else { None };
        let joints = self.joints.as_ref().or(found.as_ref())?;
        if let Some(speeds) = joints.values(message, &message.velocity) {
            return Some(WheelReading::of_slice(stamp_ns, &speeds));
        }
        let positions = joints.values(message, &message.position)?;
        self.counts.reading(stamp_ns, &positions)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn owned(names: &[&str]) -> Vec<String> {
        names.iter().map(|&name| name.to_owned()).collect()
    }

    #[test]
    fn a_message_of_a_reading_is_read_as_it_was() {
        for kind in BaseKind::ALL {
            let values = [1.5, 0.25, -3.0, 4.0];
            let written = WheelReading::of_slice(7_000_000_000, &values[..kind.columns().len()]);
            let message = wheel_message(&written, kind, "base_link").unwrap();
            let joints = WheelJoints::named(kind, &owned(kind.columns()));
            let read = JointReader::new(kind, joints, None).reading(7_000_000_000, &message);
            assert_eq!(read, Some(written));
        }
    }

    #[test]
    fn joints_are_found_by_their_names() {
        let names = owned(&["arm", "fr_wheel_joint", "fl_wheel_joint", "rr_wheel_joint", "bl_wheel_joint"]);
        let found = WheelJoints::among(BaseKind::Mecanum, &names).unwrap();
        let order: Vec<&String> = found.names().collect();
        assert_eq!(order, ["fl_wheel_joint", "fr_wheel_joint", "bl_wheel_joint", "rr_wheel_joint"]);
        let names = owned(&["wheel_front_left", "wheel_front_right", "wheel_back_left", "wheel_back_right"]);
        let found = WheelJoints::among(BaseKind::Mecanum, &names).unwrap();
        assert!(found.names().eq(&names));
        let car =
            owned(&["front_left_steering", "front_right_steering", "rear_left_wheel", "rear_right_wheel"]);
        let found = WheelJoints::among(BaseKind::Ackermann, &car).unwrap();
        assert_eq!(
            found.columns,
            [vec![car[2].clone(), car[3].clone()], vec![car[0].clone(), car[1].clone()]]
        );
        assert_eq!(WheelJoints::among(BaseKind::Omni3, &names), None);
    }

    #[test]
    fn a_steering_is_its_position_beside_the_speed_of_the_wheels() {
        let base = BaseKind::Ackermann;
        let joints = WheelJoints::named(base, &owned(&["axle", "steering"]));
        let mut reader = JointReader::new(base, joints, None);
        let message = JointState {
            name: owned(&["steering", "axle"]),
            position: vec![0.2, 77.0],
            velocity: vec![0.0, 5.0],
            ..JointState::default()
        };
        assert_eq!(reader.reading(1, &message).unwrap().values[..2], [5.0, 0.2]);
        assert_eq!(reader.reading(1, &JointState::default()), None);
        assert_eq!(WheelJoints::named(base, &owned(&["axle"])), None);
    }
}
