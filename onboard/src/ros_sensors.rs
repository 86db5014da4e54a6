//! Sensors that are ROS 2 topics.

use crate::arguments::CalibrationArguments;
use anyhow::bail;
use ros_messages::RosMessage;
use ros_messages::sensor_msgs::{CompressedImage, Image, Imu};
use ros2::{Node, NodeOptions, Qos, Received, Reliability, RosError, Subscriber};
use sensors::live::{LiveFrames, LiveImage, LiveInputs, LiveSettings, RawPixels, Stream};
use sensors::ros::{NotMeasured, imu_sample};
use std::sync::Arc;
use tokio::task::JoinHandle;
use vision::RawImage;

/// Readings that may wait to be handed in: ten seconds at 1 kHz. None is dropped unless the processor stands still.
const IMU_QUEUE: usize = 10_000;
/// Images that may wait to be handed in. Handing in takes microseconds; the source has a queue of its own.
const IMAGE_QUEUE: usize = 10;
/// How image_transport ends the topic of compressed images.
const COMPRESSED: &str = "/compressed";

/// The topics of a robot's sensors.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RosTopics {
    /// `sensor_msgs/Imu`.
    pub imu: String,
    /// One or two cameras: `sensor_msgs/Image`, or `sensor_msgs/CompressedImage` where the name ends in `/compressed`.
    pub cameras: Vec<String>,
}

impl RosTopics {
    /// The topics that the switches name.
    ///
    /// # Errors
    /// A topic is missing.
    pub fn of(arguments: &CalibrationArguments) -> anyhow::Result<Self> {
        let (Some(imu), cameras) = (arguments.imu_topic.clone(), arguments.camera_topic.clone()) else {
            bail!("--imu-topic is missing: name the topic of sensor_msgs/Imu, for example /imu")
        };
        if arguments.accelerometer_topic.is_some() {
            bail!(
                "--accelerometer-topic is for bags only: let the driver unite both (RealSense: unite_imu_method:=2), and name \
                 that topic with --imu-topic"
            )
        }
        if cameras.is_empty() {
            bail!("--camera-topic is missing: name a topic of images, for example /cam0/image_raw")
        }
        Ok(Self { imu, cameras })
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
        let source = |topic: &str, stream| Source {
            node: Arc::clone(&node),
            topic: topic.to_owned(),
            stream,
            inputs: inputs.clone(),
        };
        let imu = node.subscriber::<Imu>(&topics.imu, Qos::sensor_data(), IMU_QUEUE).await?;
        let mut tasks = vec![hand_in(imu, source(&topics.imu, Stream::Imu), |inputs, message| {
            inputs.imu(imu_sample(&message)?);
            Ok(())
        })];
        for (camera, topic) in topics.cameras.iter().enumerate() {
            let source = source(topic, Stream::Camera(camera));
            let task = if topic.ends_with(COMPRESSED) {
                let images =
                    node.subscriber::<CompressedImage>(topic, Qos::sensor_data(), IMAGE_QUEUE).await?;
                hand_in(images, source, move |inputs, message| {
                    let stamp_ns = message.header.stamp.to_nanoseconds();
                    inputs.image(camera, stamp_ns, LiveImage::Encoded(message.data));
                    Ok(())
                })
            } else {
                let images = node.subscriber::<Image>(topic, Qos::sensor_data(), IMAGE_QUEUE).await?;
                hand_in(images, source, move |inputs, message| {
                    let stamp_ns = message.header.stamp.to_nanoseconds();
                    inputs.image(camera, stamp_ns, raw_image(message)?);
                    Ok(())
                })
            };
            tasks.push(task);
        }
        Ok(Self { tasks, _node: node })
    }
}

impl Drop for RosSensors {
    fn drop(&mut self) {
        self.tasks.iter().for_each(JoinHandle::abort);
    }
}

/// A topic, and which stream of a live source it is.
struct Source {
    node: Arc<Node>,
    topic: String,
    stream: Stream,
    inputs: LiveInputs,
}

impl Source {
    /// Looks what the publishers offer, once there are any.
    async fn note_offers(&self) {
        let offers = self.node.offers(&self.topic).await.unwrap_or_default();
        if offers.contains(&Reliability::BestEffort) {
            self.inputs.best_effort(self.stream);
        }
    }
}

/// Hands in what a subscriber receives, and says what cannot be.
fn hand_in<M: RosMessage + Send + 'static>(
    subscriber: Subscriber<M>,
    source: Source,
    take: impl Fn(&LiveInputs, M) -> Result<(), Unusable> + Send + 'static,
) -> JoinHandle<()> {
    tokio::spawn(async move {
        let Source { inputs, stream, .. } = &source;
        let mut is_first = true;
        while let Ok(Received { message, .. }) = subscriber.receive().await {
            match message {
                Ok(message) => {
                    // Before the message, so that a recording knows it in time.
                    if std::mem::take(&mut is_first) {
                        source.note_offers().await;
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
    use sensors::{SensorEvent, SensorSource};
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

    #[test]
    fn topics_become_the_events_of_a_live_source_and_what_is_wrong_is_named() {
        let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap();
        let options = SimulationOptions { duration_s: Some(1.0), ..SimulationOptions::default() };
        let mut calibration = simulate(&options).unwrap().live.calibration().clone();
        calibration.cameras.truncate(1);
        let size = (calibration.cameras[0].camera.width, calibration.cameras[0].camera.height);
        let (inputs, mut source) =
            LiveSource::new("test", calibration.clone(), &LiveSettings::images(&calibration));
        let topics = RosTopics { imu: "/imu".into(), cameras: vec!["/cam0/image_raw".into()] };
        let (node, sensors) = runtime.block_on(async {
            let mut config = zenoh::Config::default();
            config.insert_json5("scouting/multicast/enabled", "false").unwrap();
            config.insert_json5("listen/endpoints", "[]").unwrap();
            let session = zenoh::open(config).await.unwrap();
            let options = NodeOptions { name: "sensors".to_owned(), ..NodeOptions::default() };
            let sensors = RosSensors::start(session.clone(), options, &topics, &inputs).await.unwrap();
            let node = Node::new(session, NodeOptions::default()).await.unwrap();
            let readings = node.publisher::<Imu>("/imu", Qos::reliable()).await.unwrap();
            let images = node.publisher::<Image>("/cam0/image_raw", Qos::sensor_data()).await.unwrap();
            images.publish(&image(1, size, "h264")).await.unwrap();
            for milliseconds in (0..200).step_by(5) {
                readings.publish(&imu(milliseconds)).await.unwrap();
            }
            images.publish(&image(50, size, "mono8")).await.unwrap();
            (node, sensors)
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
        let report = source.live().unwrap();
        assert_eq!(report.best_effort, [Stream::Camera(0)], "the readings are reliable");
        let faults = report.faults;
        let unreadable =
            faults.iter().find(|fault| fault.kind == FaultKind::Unreadable).expect("the encoding is named");
        assert!(unreadable.to_string().contains("h264"), "{unreadable}");
        drop((sensors, node));
    }
}
