//! Sensors that are ROS 2 topics.

use crate::arguments::{CalibrationArguments, GnssArguments, RobotArguments};
use crate::ros_wheels::{RosJoints, RosWheels};
use crate::topic_watch::TopicWatch;
use anyhow::bail;
use ros_messages::RosMessage;
use ros_messages::nav_msgs::Odometry;
use ros_messages::sensor_msgs::{CompressedImage, Image, Imu, JointState, NavSatFix};
use ros2::{Node, NodeOptions, Qos, Received, Reliability, RosError, Subscriber};
use sensors::live::{LiveFrames, LiveImage, LiveInputs, LiveSettings, RawPixels, Stream};
use sensors::ros::{JointReader, MovesSideways, NotMeasured, base_velocity, imu_sample, satellite_position};
use sensors::{GnssIntake, GnssProblem, GnssSensor, SensorCalibration, SplitImu};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use tokio::task::JoinHandle;
use vision::RawImage;

/// Readings that may wait to be handed in: ten seconds at 1 kHz. None is dropped unless the processor stands still.
const IMU_QUEUE: usize = 10_000;
/// Readings of the wheels that may wait to be handed in.
const WHEEL_QUEUE: usize = 1000;
/// Positions of GNSS that may wait to be handed in.
const GNSS_QUEUE: usize = 100;
/// Images that may wait to be handed in. Handing in takes microseconds; the source has a queue of its own.
const IMAGE_QUEUE: usize = 10;
/// Angular velocities that wait longer for the accelerometer are said to, nanoseconds.
const LONGEST_WAIT_NS: i64 = 1_000_000_000;
/// So many of the first messages of a topic are looked at for what its publishers offer.
const OFFER_LOOKS: usize = 5;
/// How image_transport ends the topic of compressed images.
const COMPRESSED: &str = "/compressed";

/// The topics of a robot's sensors.
#[derive(Clone, Debug, PartialEq)]
pub struct RosTopics {
    /// `sensor_msgs/Imu`, of both sensors or of the gyroscope.
    pub imu: String,
    /// `sensor_msgs/Imu` of the accelerometer, where it has a topic of its own.
    pub accelerometer: Option<String>,
    /// The cameras: `sensor_msgs/Image`, or `sensor_msgs/CompressedImage` where the name ends in `/compressed`.
    pub cameras: Vec<String>,
    /// The wheels, if they are used.
    pub wheels: Option<RosWheels>,
    /// GNSS, if it is used.
    pub gnss: Option<RosGnss>,
}

/// The topic of a robot's GNSS.
#[derive(Clone, Debug, PartialEq)]
pub struct RosGnss {
    /// `sensor_msgs/NavSatFix`.
    pub topic: String,
    /// The frame that its positions are turned to.
    pub sensor: GnssSensor,
}

impl RosGnss {
    /// The topic that the switches name; what they leave out is as in the calibration.
    ///
    /// # Errors
    /// An origin that is no place on the earth.
    fn of(arguments: &GnssArguments, calibrated: Option<GnssSensor>) -> anyhow::Result<Option<Self>> {
        let Some(topic) = arguments.gnss_topic.clone() else { return Ok(None) };
        Ok(Some(Self { topic, sensor: arguments.live_sensor(calibrated)? }))
    }
}

impl RosTopics {
    /// The topics of IMU and cameras that the switches name.
    ///
    /// # Errors
    /// A topic is missing.
    pub fn of(arguments: &CalibrationArguments) -> anyhow::Result<Self> {
        let (Some(imu), cameras) = (arguments.imu_topic.clone(), arguments.camera_topic.clone()) else {
            bail!("--imu-topic is missing: name the topic of sensor_msgs/Imu, for example /imu")
        };
        if cameras.is_empty() {
            bail!("--camera-topic is missing: name a topic of images, for example /cam0/image_raw")
        }
        let accelerometer =
            arguments.accelerometer_topic.clone().filter(|accelerometer| *accelerometer != imu);
        Ok(Self { imu, accelerometer, cameras, wheels: None, gnss: None })
    }

    /// Adds the topics of wheels and GNSS that the switches name; what these leave out is as in the calibration, whose wheels become
    /// those of the readings.
    ///
    /// # Errors
    /// Joints, encoders or an origin that cannot be used.
    pub fn add_wheels_and_gnss(
        &mut self,
        arguments: &RobotArguments,
        calibration: &mut SensorCalibration,
    ) -> anyhow::Result<()> {
        self.wheels = RosWheels::of(&arguments.wheels, calibration.wheels.as_ref())?;
        self.gnss = RosGnss::of(&arguments.gnss, calibration.gnss)?;
        if let (Some(topic), Some(wheels)) = (&self.wheels, &mut calibration.wheels) {
            *wheels = topic.sensor(wheels);
        }
        Ok(())
    }

    /// Adapts the settings of the source to these topics: fewer topics are fewer cameras.
    ///
    /// # Errors
    /// There are more cameras than are calibrated, or frames are to be no images.
    pub fn adapt(&self, settings: &mut LiveSettings) -> anyhow::Result<()> {
        let cameras = &self.cameras;
        if cameras.len() > settings.cameras {
            bail!("--camera-topic names {} cameras, but {} are used", cameras.len(), settings.cameras)
        }
        if settings.frames != LiveFrames::Images {
            bail!("ROS 2 has no messages for tracks: leave --live-frames out")
        }
        settings.cameras = cameras.len();
        settings.wheels = self.wheels.as_ref().map(RosWheels::readings);
        settings.gnss = self.gnss.is_some();
        Ok(())
    }
}

/// Hands the messages of a robot's topics to a live source, as long as it exists.
#[derive(Debug)]
pub struct RosSensors {
    tasks: Vec<JoinHandle<()>>,
    _node: Arc<Node>,
}

impl RosSensors {
    /// Subscribes, as a node of its own. Topics may begin to exist later. Needs a tokio runtime.
    ///
    /// # Errors
    /// [`RosError`]: a topic whose name ROS does not allow, or a session that is closed.
    pub async fn start(
        session: zenoh::Session,
        node: NodeOptions,
        topics: &RosTopics,
        inputs: &LiveInputs,
    ) -> Result<Self, RosError> {
        let node = Arc::new(Node::new(session, node).await?);
        let mut sources = Sources { node: Arc::clone(&node), inputs, watch: TopicWatch::default() };
        let mut tasks = sources.hand_in_imu(topics).await?;
        for (camera, topic) in topics.cameras.iter().enumerate() {
            let stream = Stream::Camera(camera);
            let task = if topic.ends_with(COMPRESSED) {
                let images =
                    node.subscriber::<CompressedImage>(topic, Qos::sensor_data(), IMAGE_QUEUE).await?;
                let source = sources.source::<CompressedImage>(topic, stream)?;
                hand_in(images, source, move |inputs, message| {
                    let stamp_ns = message.header.stamp.to_nanoseconds();
                    inputs.image(camera, stamp_ns, LiveImage::Encoded(message.data));
                    Ok(())
                })
            } else {
                let images = node.subscriber::<Image>(topic, Qos::sensor_data(), IMAGE_QUEUE).await?;
                let source = sources.source::<Image>(topic, stream)?;
                hand_in(images, source, move |inputs, message| {
                    let stamp_ns = message.header.stamp.to_nanoseconds();
                    inputs.image(camera, stamp_ns, raw_image(message)?);
                    Ok(())
                })
            };
            tasks.push(task);
        }
        if let Some(wheels) = &topics.wheels {
            tasks.push(sources.hand_in_wheels(wheels).await?);
        }
        if let Some(gnss) = &topics.gnss {
            tasks.push(sources.hand_in_gnss(gnss).await?);
        }
        tasks.push(sources.watch.start(Arc::clone(&node)));
        Ok(Self { tasks, _node: node })
    }
}

impl Drop for RosSensors {
    fn drop(&mut self) {
        self.tasks.iter().for_each(JoinHandle::abort);
    }
}

/// Makes the sources of one live source.
struct Sources<'a> {
    node: Arc<Node>,
    inputs: &'a LiveInputs,
    watch: TopicWatch,
}

impl Sources<'_> {
    fn source<M: RosMessage>(&mut self, topic: &str, stream: Stream) -> Result<Source, RosError> {
        Ok(Source {
            node: Arc::clone(&self.node),
            topic: topic.to_owned(),
            stream,
            inputs: self.inputs.clone(),
            heard: self.watch.expect::<M>(&self.node, topic)?,
        })
    }

    /// Hands in the readings of the wheels.
    async fn hand_in_wheels(&mut self, wheels: &RosWheels) -> Result<JoinHandle<()>, RosError> {
        match wheels {
            RosWheels::Base(topic, base) => {
                let messages =
                    self.node.subscriber::<Odometry>(topic, Qos::sensor_data(), WHEEL_QUEUE).await?;
                let source = self.source::<Odometry>(topic, Stream::Wheels)?;
                let base = *base;
                Ok(hand_in(messages, source, move |inputs, message| {
                    inputs.wheels(base_velocity(&message, base)?);
                    Ok(())
                }))
            }
            RosWheels::Joints(topic, RosJoints { base, joints, encoder }) => {
                let messages =
                    self.node.subscriber::<JointState>(topic, Qos::sensor_data(), WHEEL_QUEUE).await?;
                let source = self.source::<JointState>(topic, Stream::Wheels)?;
                let mut reader = JointReader::new(*base, joints.clone(), *encoder);
                Ok(hand_in(messages, source, move |inputs, message: JointState| {
                    // Messages of other joints, of an arm, come on the same topic.
                    let stamp_ns = message.header.stamp.to_nanoseconds();
                    if let Some(reading) = reader.reading(stamp_ns, &message) {
                        inputs.wheels(reading);
                    }
                    Ok(())
                }))
            }
        }
    }

    /// Hands in the positions of GNSS. A receiver without one is no fault: there may be a roof above it.
    async fn hand_in_gnss(&mut self, gnss: &RosGnss) -> Result<JoinHandle<()>, RosError> {
        let RosGnss { topic, sensor } = gnss;
        let messages = self.node.subscriber::<NavSatFix>(topic, Qos::sensor_data(), GNSS_QUEUE).await?;
        let source = self.source::<NavSatFix>(topic, Stream::Gnss)?;
        let intake = GnssIntake::new(sensor);
        Ok(hand_in(messages, source, move |inputs, message: NavSatFix| {
            let Ok(position) = satellite_position(&message) else {
                inputs.nothing(Stream::Gnss);
                return Ok(());
            };
            inputs.gnss(intake.take(position.stamp_ns, &position.geodetic, position.covariance)?);
            Ok(())
        }))
    }

    /// Hands in the readings of the IMU, or those of gyroscope and accelerometer united.
    async fn hand_in_imu(&mut self, topics: &RosTopics) -> Result<Vec<JoinHandle<()>>, RosError> {
        let imu = self.node.subscriber::<Imu>(&topics.imu, Qos::sensor_data(), IMU_QUEUE).await?;
        let source = self.source::<Imu>(&topics.imu, Stream::Imu)?;
        let Some(accelerometer) = &topics.accelerometer else {
            return Ok(vec![hand_in(imu, source, |inputs, message| {
                inputs.imu(imu_sample(&message)?);
                Ok(())
            })]);
        };
        let of_accelerometer = self.source::<Imu>(accelerometer, Stream::Imu)?;
        let accelerometer = self.node.subscriber::<Imu>(accelerometer, Qos::sensor_data(), IMU_QUEUE).await?;
        let united = Arc::new(Mutex::new(SplitImu::default()));
        let of_gyroscope = Arc::clone(&united);
        let gyroscope = hand_in(imu, source, move |inputs, message: Imu| {
            let mut united = of_gyroscope.lock().unwrap_or_else(PoisonError::into_inner);
            let value: [f64; 3] = message.angular_velocity.into();
            united.add_gyroscope(message.header.stamp.to_nanoseconds(), value.into());
            hand_in_united(&mut united, inputs)
        });
        let accelerometer = hand_in(accelerometer, of_accelerometer, move |inputs, message: Imu| {
            let mut united = united.lock().unwrap_or_else(PoisonError::into_inner);
            let value: [f64; 3] = message.linear_acceleration.into();
            united.add_accelerometer(message.header.stamp.to_nanoseconds(), value.into());
            hand_in_united(&mut united, inputs)
        });
        Ok(vec![gyroscope, accelerometer])
    }
}

/// Hands in the readings that are complete.
fn hand_in_united(united: &mut SplitImu, inputs: &LiveInputs) -> Result<(), Unusable> {
    std::iter::from_fn(|| united.pop()).for_each(|reading| inputs.imu(reading));
    if united.waiting_ns() > LONGEST_WAIT_NS { Err(Unusable::NoAccelerometer) } else { Ok(()) }
}

/// A topic, and which stream of a live source it is.
struct Source {
    node: Arc<Node>,
    topic: String,
    stream: Stream,
    inputs: LiveInputs,
    /// Set with its first message.
    heard: Arc<AtomicBool>,
}

impl Source {
    /// Looks what the publishers offer; whether any was seen: a token may come later than the first message.
    async fn note_offers(&self) -> bool {
        let offers = self.node.offers(&self.topic).await.unwrap_or_default();
        if offers.contains(&Reliability::BestEffort) {
            self.inputs.best_effort(self.stream);
        }
        !offers.is_empty()
    }
}

/// Hands in what a subscriber receives, and says what cannot be.
fn hand_in<M: RosMessage + Send + 'static>(
    subscriber: Subscriber<M>,
    source: Source,
    mut take: impl FnMut(&LiveInputs, M) -> Result<(), Unusable> + Send + 'static,
) -> JoinHandle<()> {
    tokio::spawn(async move {
        let Source { inputs, stream, heard, .. } = &source;
        let mut looks = OFFER_LOOKS;
        while let Ok(Received { message, .. }) = subscriber.receive().await {
            heard.store(true, Ordering::Relaxed);
            match message {
                Ok(message) => {
                    // Before the message, so that a recording knows it in time.
                    if looks > 0 {
                        looks = if source.note_offers().await { 0 } else { looks - 1 };
                    }
                    if let Err(problem) = take(inputs, message) {
                        inputs.refuse(*stream, problem);
                    }
                }
                Err(error) => inputs.refuse(*stream, error),
            }
        }
    })
}

/// Why a message is of no use.
#[derive(Debug, thiserror::Error)]
enum Unusable {
    #[error(transparent)]
    NotMeasured(#[from] NotMeasured),
    #[error(transparent)]
    MovesSideways(#[from] MovesSideways),
    #[error(transparent)]
    Gnss(#[from] GnssProblem),
    #[error("nothing comes from the accelerometer, or its clock is another: see --accelerometer-topic")]
    NoAccelerometer,
    #[error("images are {0:?}: set the driver to mono8, rgb8 or bgr8, or use its compressed topic")]
    Encoding(String),
}

fn raw_image(message: Image) -> Result<LiveImage, Unusable> {
    let Image { width, height, step, encoding, is_bigendian, data: bytes, .. } = message;
    if RawImage::bytes_per_pixel(&encoding).is_none() {
        return Err(Unusable::Encoding(encoding));
    }
    Ok(LiveImage::Raw(RawPixels { width, height, step, encoding, big_endian: is_bigendian != 0, bytes }))
}

#[cfg(test)]
mod tests;
