//! Readings and frames of a bag in order of time.

use super::image::BagImage;
use super::index::{Stamped, StampedTopic};
use super::messages;
use crate::pairing::{JoinedImages, PairCounts, join_recorded};
use crate::ros::imu_sample;
use crate::{CameraSensor, Frame, ImageData, ImuSample, SequenceError};
use bags::Bag;
use nalgebra::Vector3;
use ros_messages::sensor_msgs::Imu;
use std::sync::Arc;

/// The values of a topic's messages in order of time; what cannot be used is left out and counted.
pub(super) struct Values<F> {
    bag: Arc<Bag>,
    topic: Arc<StampedTopic>,
    /// Number of the next message.
    next: usize,
    /// The value of a message.
    read: F,
    unusable: usize,
}

impl<F> Values<F> {
    pub(super) fn new(bag: &Arc<Bag>, topic: &Arc<StampedTopic>, read: F) -> Self {
        Self { bag: Arc::clone(bag), topic: Arc::clone(topic), next: 0, read, unusable: 0 }
    }
}

impl<T, F: FnMut(&Bag, usize, Stamped) -> Option<T>> Iterator for Values<F> {
    type Item = (i64, T);

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            let Some(&message) = self.topic.messages.get(self.next) else {
                let why = "are damaged, of another encoding, not finite, or without what is measured";
                self.topic.tell_once(&self.bag, self.unusable, why);
                return None;
            };
            self.next += 1;
            match (self.read)(&self.bag, self.topic.topic, message) {
                Some(value) => return Some((message.stamp_ns, value)),
                None => self.unusable += 1,
            }
        }
    }
}

/// The readings of an IMU.
pub(super) fn readings(
    bag: &Arc<Bag>,
    topic: &Arc<StampedTopic>,
) -> impl Iterator<Item = Result<ImuSample, SequenceError>> + 'static {
    let values = Values::new(bag, topic, |bag: &Bag, topic, message: Stamped| {
        let sample = imu_sample(&messages::read::<Imu>(bag, topic, message.place).ok()?).ok()?;
        (is_finite(&sample.gyroscope) && is_finite(&sample.accelerometer)).then_some(sample)
    });
    values.map(|(stamp_ns, sample)| Ok(ImuSample { stamp_ns, ..sample }))
}

pub(super) fn is_finite(vector: &Vector3<f64>) -> bool {
    vector.iter().all(|value| value.is_finite())
}

/// The cameras of a bag: which images make a frame.
#[derive(Debug)]
pub(super) struct Cameras {
    topics: Vec<Arc<StampedTopic>>,
    frames: Vec<JoinedImages>,
    /// Of stereo pairs.
    pub(super) pairs: Option<PairCounts>,
}

impl Cameras {
    pub(super) fn new(topics: Vec<Arc<StampedTopic>>, cameras: &[CameraSensor], tolerance_ns: i64) -> Self {
        let stamps = topics.iter().map(|topic| topic.messages.iter().map(|message| message.stamp_ns));
        let (frames, pairs) = join_recorded(cameras, stamps, tolerance_ns);
        Self { topics, frames, pairs }
    }
}

/// The frames of the cameras of a bag.
pub(super) struct FrameRows {
    bag: Arc<Bag>,
    cameras: Arc<Cameras>,
    time_offset_ns: i64,
    next: usize,
}

impl FrameRows {
    /// # Arguments
    /// * `time_offset_ns`: added to the stamps.
    pub(super) fn new(bag: &Arc<Bag>, cameras: &Arc<Cameras>, time_offset_ns: i64) -> Self {
        Self { bag: Arc::clone(bag), cameras: Arc::clone(cameras), time_offset_ns, next: 0 }
    }
}

impl Iterator for FrameRows {
    type Item = Result<Frame, SequenceError>;

    fn next(&mut self) -> Option<Self::Item> {
        let Cameras { topics, frames, .. } = &*self.cameras;
        let joined = frames.get(self.next)?;
        let image = |topic: &StampedTopic, number: usize| {
            let Stamped { stamp_ns, place } = topic.messages[number];
            let image = BagImage { bag: Arc::clone(&self.bag), topic: topic.topic, stamp_ns, place };
            ImageData::Stored(Arc::new(image))
        };
        let numbers = topics.iter().zip(&joined.images).enumerate();
        let images = numbers
            .filter_map(|(camera, (topic, number))| Some((camera, image(topic, (*number)?))))
            .collect();
        self.next += 1;
        let stamp_ns = joined.stamp_ns.saturating_add(self.time_offset_ns);
        Some(Ok(Frame { stamp_ns, images, ..Frame::default() }))
    }
}
