//! Sensors that are ROS 2 topics.

use crate::arguments::{CalibrationArguments, WheelArguments};
use crate::ros_wheels::{RosJoints, RosWheels};
use crate::topic_watch::TopicWatch;
use anyhow::bail;
use ros_messages::RosMessage;
use ros_messages::nav_msgs::Odometry;
use ros_messages::sensor_msgs::{CompressedImage, Image, Imu, JointState};
use ros2::{Node, NodeOptions, Qos, Received, Reliability, RosError, Subscriber};
use sensors::SplitImu;
use sensors::live::{LiveFrames, LiveImage, LiveInputs, LiveSettings, RawPixels, Stream};
use sensors::ros::{JointReader, MovesSideways, NotMeasured, base_velocity, imu_sample};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use tokio::task::JoinHandle;
use vision::RawImage;

/// Readings that may wait to be handed in: ten seconds at 1 kHz. None is dropped unless the processor stands still.
const IMU_QUEUE: usize = 10_000;
/// Readings of the wheels that may wait to be handed in.
const WHEEL_QUEUE: usize = 1000;
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
}

impl RosTopics {
    /// The topics that the switches name.
    ///
    /// # Errors
    /// A topic is missing.
    pub fn of(arguments: &CalibrationArguments, wheels: &WheelArguments) -> anyhow::Result<Self> {
        let (Some(imu), cameras) = (arguments.imu_topic.clone(), arguments.camera_topic.clone()) else {
            bail!("--imu-topic is missing: name the topic of sensor_msgs/Imu, for example /imu")
        };
        if cameras.is_empty() {
            bail!("--camera-topic is missing: name a topic of images, for example /cam0/image_raw")
        }
        let accelerometer =
            arguments.accelerometer_topic.clone().filter(|accelerometer| *accelerometer != imu);
        let wheels = RosWheels::of(wheels)?;
        Ok(Self { imu, accelerometer, cameras, wheels })
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
mod tests {
    use super::*;
    use ros_messages::builtin_interfaces::Time;
    use ros_messages::std_msgs::Header;
    use sensors::live::{FaultKind, LiveSource};
    use sensors::{BaseKind, SensorEvent, SensorSource, WheelReadings};
    use simulation::{SimulationOptions, simulate};
    use std::time::{Duration, Instant};

    const TIMEOUT: Duration = Duration::from_secs(20);

    fn header(milliseconds: i64) -> Header {
        let stamp = Time::from_nanoseconds(1_000_000_000_000 + milliseconds * 1_000_000).unwrap();
        Header { stamp, frame_id: "sensor".into() }
    }

    fn imu(milliseconds: i64) -> Imu {
        let linear_acceleration = [0.0, 0.0, 9.81].into();
        Imu { header: header(milliseconds), linear_acceleration, ..Imu::default() }
    }

    fn image(milliseconds: i64, (width, height): (u32, u32), encoding: &str) -> Image {
        let data = vec![milliseconds as u8; (width * height) as usize];
        let encoding = encoding.to_owned();
        Image { header: header(milliseconds), width, height, encoding, step: width, data, ..Image::default() }
    }

    /// The topics in a session of their own, and a node that publishes there.
    async fn subscribed(topics: &RosTopics, inputs: &LiveInputs) -> (Node, RosSensors) {
        let mut config = zenoh::Config::default();
        config.insert_json5("scouting/multicast/enabled", "false").unwrap();
        config.insert_json5("listen/endpoints", "[]").unwrap();
        let session = zenoh::open(config).await.unwrap();
        let options = NodeOptions { name: "sensors".to_owned(), ..NodeOptions::default() };
        let sensors = RosSensors::start(session.clone(), options, topics, inputs).await.unwrap();
        (Node::new(session, NodeOptions::default()).await.unwrap(), sensors)
    }

    #[test]
    fn gyroscope_and_accelerometer_of_two_topics_are_united() {
        let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap();
        let options = SimulationOptions { duration_s: Some(1.0), ..SimulationOptions::default() };
        let calibration = simulate(&options).unwrap().live.calibration().clone();
        let (inputs, mut source) =
            LiveSource::new("test", calibration.clone(), &LiveSettings::images(&calibration));
        let topics = RosTopics {
            imu: "/gyro".into(),
            accelerometer: Some("/accel".into()),
            cameras: vec!["/cam0/image_raw".into()],
            wheels: None,
        };
        let (node, sensors) = runtime.block_on(async {
            let (node, sensors) = subscribed(&topics, &inputs).await;
            let gyroscope = node.publisher::<Imu>("/gyro", Qos::sensor_data()).await.unwrap();
            let accelerometer = node.publisher::<Imu>("/accel", Qos::sensor_data()).await.unwrap();
            for milliseconds in (0..200).step_by(5) {
                let angular_velocity = [milliseconds as f64, 0.0, 0.0].into();
                let header = header(milliseconds);
                gyroscope.publish(&Imu { header, angular_velocity, ..Imu::default() }).await.unwrap();
                if milliseconds % 10 == 0 {
                    accelerometer.publish(&imu(milliseconds)).await.unwrap();
                }
            }
            (node, sensors)
        });
        let begin = Instant::now();
        let mut readings = Vec::new();
        // The last one is behind the last specific force.
        while readings.len() < 39 {
            assert!(begin.elapsed() < TIMEOUT, "{} readings, {:?}", readings.len(), source.live());
            if let SensorEvent::Imu(reading) = source.next().unwrap().expect("no end") {
                readings.push(reading);
            }
        }
        for (number, reading) in readings.iter().enumerate() {
            assert_eq!((reading.gyroscope.x, reading.accelerometer.z), (5.0 * number as f64, 9.81));
        }
        drop((sensors, node));
    }

    #[test]
    fn topics_become_the_events_of_a_live_source_and_what_is_wrong_is_named() {
        let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap();
        let options = SimulationOptions { duration_s: Some(1.0), ..SimulationOptions::default() };
        let mut calibration = simulate(&options).unwrap().live.calibration().clone();
        calibration.cameras.truncate(1);
        let size = (calibration.cameras[0].camera.width, calibration.cameras[0].camera.height);
        let (inputs, mut source) =
            LiveSource::new("test", calibration.clone(), &LiveSettings::images(&calibration));
        let topics = RosTopics {
            imu: "/imu".into(),
            accelerometer: None,
            cameras: vec!["/cam0/image_raw".into()],
            wheels: None,
        };
        let (node, sensors, images) = runtime.block_on(async {
            let (node, sensors) = subscribed(&topics, &inputs).await;
            let readings = node.publisher::<Imu>("/imu", Qos::reliable()).await.unwrap();
            let images = node.publisher::<Image>("/cam0/image_raw", Qos::sensor_data()).await.unwrap();
            images.publish(&image(1, size, "h264")).await.unwrap();
            for milliseconds in (0..200).step_by(5) {
                readings.publish(&imu(milliseconds)).await.unwrap();
            }
            images.publish(&image(50, size, "mono8")).await.unwrap();
            (node, sensors, images)
        });
        let begin = Instant::now();
        let (mut stamps, mut frame) = (Vec::new(), None);
        while stamps.len() < 40 || frame.is_none() {
            assert!(begin.elapsed() < TIMEOUT, "{} readings, {frame:?}, {:?}", stamps.len(), source.live());
            match source.next().unwrap().expect("no end") {
                SensorEvent::Imu(reading) => stamps.push(reading.stamp_ns),
                SensorEvent::Frame(new) => frame = Some(new),
                _ => {}
            }
        }
        assert!(stamps.is_sorted() && stamps[0] == header(0).stamp.to_nanoseconds());
        assert_eq!(frame.unwrap().stamp_ns, header(50).stamp.to_nanoseconds());
        // The token of a publisher may be seen later than its messages.
        while source.live().unwrap().best_effort.is_empty() && begin.elapsed() < TIMEOUT {
            runtime.block_on(images.publish(&image(100, size, "h264"))).unwrap();
            std::thread::sleep(Duration::from_millis(20));
        }
        let report = source.live().unwrap();
        assert_eq!(report.best_effort, [Stream::Camera(0)], "the readings are reliable");
        let faults = report.faults;
        let unreadable =
            faults.iter().find(|fault| fault.kind == FaultKind::Unreadable).expect("the encoding is named");
        assert!(unreadable.to_string().contains("h264"), "{unreadable}");
        drop((sensors, node));
    }

    #[test]
    fn wheels_come_from_the_velocity_of_the_base_or_from_joints() {
        let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap();
        let options = SimulationOptions { duration_s: Some(1.0), ..SimulationOptions::default() };
        let calibration = simulate(&options).unwrap().live.calibration().clone();
        let joints = RosWheels::Joints("/wheels".into(), RosJoints::default());
        for (wheels, kind) in [
            (RosWheels::Base("/wheels".into(), BaseKind::Differential), WheelReadings::BaseVelocities),
            (joints, WheelReadings::Speeds),
        ] {
            let topics = RosTopics {
                imu: "/imu".into(),
                accelerometer: None,
                cameras: vec!["/cam0/image_raw".into()],
                wheels: Some(wheels),
            };
            let mut settings = LiveSettings::images(&calibration);
            topics.adapt(&mut settings).unwrap();
            let (inputs, mut source) = LiveSource::new("test", calibration.clone(), &settings);
            assert_eq!(source.contents().wheels, Some(kind));
            let kept = runtime.block_on(async {
                let (node, sensors) = subscribed(&topics, &inputs).await;
                let bases = node.publisher::<Odometry>("/wheels", Qos::reliable()).await.unwrap();
                let states = node.publisher::<JointState>("/wheels", Qos::reliable()).await.unwrap();
                for milliseconds in (0..200).step_by(10) {
                    let mut base = Odometry { header: header(milliseconds), ..Odometry::default() };
                    (base.twist.twist.linear.x, base.twist.twist.angular.z) = (1.0, 0.5);
                    bases.publish(&base).await.unwrap();
                    let name = vec!["left_wheel".to_owned(), "right_wheel".to_owned()];
                    let (header, velocity) = (header(milliseconds), vec![0.75, 1.25]);
                    states
                        .publish(&JointState { header, name, velocity, ..Default::default() })
                        .await
                        .unwrap();
                    let other = JointState { name: vec!["arm".to_owned()], ..JointState::default() };
                    states.publish(&other).await.unwrap();
                }
                (node, sensors, bases, states)
            });
            let begin = Instant::now();
            let mut readings = Vec::new();
            while readings.len() < 20 {
                assert!(begin.elapsed() < TIMEOUT, "{kind:?}: {} readings", readings.len());
                if let SensorEvent::Wheels(reading) = source.next().unwrap().expect("no end") {
                    readings.push(reading);
                }
            }
            for (number, reading) in readings.iter().enumerate() {
                assert_eq!(reading.stamp_ns, header(10 * number as i64).stamp.to_nanoseconds());
                assert_eq!(reading.values[..2], [0.75, 1.25]);
            }
            drop(kept);
        }
    }
}
