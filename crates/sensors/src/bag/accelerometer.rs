//! Gyroscope and accelerometer in two topics: the specific force is interpolated to the times of the gyroscope.

use super::index::{Stamped, StampedTopic};
use super::messages;
use super::rows::{Values, is_finite};
use crate::{ImuSample, SequenceError};
use bags::Bag;
use nalgebra::Vector3;
use ros_messages::sensor_msgs::Imu;
use std::iter::Peekable;
use std::sync::Arc;

/// Over longer gaps of the accelerometer the specific force is not known, nanoseconds.
const MAX_GAP_NS: i64 = 100_000_000;

type Vectors = Box<dyn Iterator<Item = (i64, Vector3<f64>)>>;

/// The readings at the times of the gyroscope. Those before the first and after the last specific force, and those within
/// its gaps, are left out.
struct Interpolated {
    bag: Arc<Bag>,
    gyroscope_topic: Arc<StampedTopic>,
    gyroscope: Vectors,
    accelerometer: Peekable<Vectors>,
    /// The newest specific force up to the reading.
    before: Option<(i64, Vector3<f64>)>,
    in_gaps: usize,
}

/// The readings of a gyroscope and an accelerometer.
pub(super) fn interpolated(
    bag: &Arc<Bag>,
    gyroscope: &Arc<StampedTopic>,
    accelerometer: &Arc<StampedTopic>,
) -> impl Iterator<Item = Result<ImuSample, SequenceError>> + 'static {
    let vectors = |topic: &Arc<StampedTopic>, part: fn(Imu) -> [f64; 3]| -> Vectors {
        let read = move |bag: &Bag, topic, message: Stamped| {
            let vector = Vector3::from(part(messages::read(bag, topic, message.place).ok()?));
            is_finite(&vector).then_some(vector)
        };
        Box::new(Values::new(bag, topic, read))
    };
    Interpolated {
        bag: Arc::clone(bag),
        gyroscope_topic: Arc::clone(gyroscope),
        gyroscope: vectors(gyroscope, |message| message.angular_velocity.into()),
        accelerometer: vectors(accelerometer, |message| message.linear_acceleration.into()).peekable(),
        before: None,
        in_gaps: 0,
    }
}

impl Interpolated {
    /// The specific force at a time; `None` where it is not known.
    fn specific_force(&mut self, stamp_ns: i64) -> Option<Vector3<f64>> {
        while let Some(passed) = self.accelerometer.next_if(|(at_ns, _)| *at_ns <= stamp_ns) {
            self.before = Some(passed);
        }
        let (from_ns, from) = self.before?;
        if from_ns == stamp_ns {
            return Some(from);
        }
        let &(to_ns, to) = self.accelerometer.peek()?;
        if to_ns.saturating_sub(from_ns) > MAX_GAP_NS {
            self.in_gaps += 1;
            return None;
        }
        let part = (stamp_ns - from_ns) as f64 / (to_ns - from_ns) as f64;
        Some(from.lerp(&to, part))
    }
}

impl Iterator for Interpolated {
    type Item = Result<ImuSample, SequenceError>;

    fn next(&mut self) -> Option<Self::Item> {
        while let Some((stamp_ns, gyroscope)) = self.gyroscope.next() {
            if let Some(accelerometer) = self.specific_force(stamp_ns) {
                return Some(Ok(ImuSample { stamp_ns, gyroscope, accelerometer }));
            }
        }
        let why = "are within gaps of the accelerometer";
        self.gyroscope_topic.tell_once(&self.bag, self.in_gaps, why);
        None
    }
}
