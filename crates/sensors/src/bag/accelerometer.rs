//! Gyroscope and accelerometer in two topics.

use super::index::{Stamped, StampedTopic};
use super::messages;
use super::rows::{Values, is_finite};
use crate::{ImuSample, SequenceError, SplitImu};
use bags::Bag;
use nalgebra::Vector3;
use ros_messages::sensor_msgs::Imu;
use std::sync::Arc;

type Vectors = Box<dyn Iterator<Item = (i64, Vector3<f64>)>>;

/// The readings at the times of the gyroscope.
struct Interpolated {
    bag: Arc<Bag>,
    gyroscope_topic: Arc<StampedTopic>,
    gyroscope: Vectors,
    accelerometer: Vectors,
    imu: SplitImu,
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
        accelerometer: vectors(accelerometer, |message| message.linear_acceleration.into()),
        imu: SplitImu::default(),
    }
}

impl Iterator for Interpolated {
    type Item = Result<ImuSample, SequenceError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some(reading) = self.imu.pop() {
                return Some(Ok(reading));
            }
            let is_waiting = self.imu.is_waiting();
            let next = if is_waiting { self.accelerometer.next() } else { self.gyroscope.next() };
            match next {
                Some((stamp_ns, force)) if is_waiting => self.imu.add_accelerometer(stamp_ns, force),
                Some((stamp_ns, angular_velocity)) => self.imu.add_gyroscope(stamp_ns, angular_velocity),
                None => break,
            }
        }
        let why = "are within gaps of the accelerometer";
        self.gyroscope_topic.tell_once(&self.bag, self.imu.in_gaps(), why);
        None
    }
}
