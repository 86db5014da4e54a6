//! Live sensors over Zenoh in Driftless' own form: see [`protocol::sensors`].

use estimator::{ImuSample, TrackObservation};
use nalgebra::{Matrix3, Vector2, Vector3};
use protocol::keys::{self, NameError};
use protocol::sensors::{
    ImageHeader, SensorMessageError, TracksMessage, check_image_length, decode_gnss, decode_imu,
    decode_wheels,
};
use sensors::live::{LiveImage, LiveInputs, RawPixels, Stream};
use sensors::{BaseKind, GnssIntake, GnssProblem, GnssSensor, WheelIntake, WheelProblem};
use std::sync::{Mutex, PoisonError};
use tokio::runtime::Handle;
use vision::RawImage;
use zenoh::pubsub::Subscriber;
use zenoh::sample::Sample;

/// Why the sensors of a robot cannot be subscribed to.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NativeError {
    /// The name of the robot cannot be part of a key.
    #[error("--robot: {0}")]
    Name(#[from] NameError),
    /// The session refuses.
    #[error("{key} cannot be subscribed to: {source}")]
    Subscribe {
        /// The key.
        key: String,
        /// Zenoh's error.
        source: zenoh::Error,
    },
}

/// Why a message is not used.
#[derive(Debug, thiserror::Error)]
enum Refusal {
    #[error(transparent)]
    Message(#[from] SensorMessageError),
    #[error("the encoding {0:?} is unknown: use jpeg, png, mono8, bgr8, rgb8 or another of docs/src/live.md")]
    Encoding(String),
    #[error("a step of {0} bytes a row is too long")]
    Step(u64),
    #[error(transparent)]
    Wheels(#[from] WheelProblem),
    #[error(transparent)]
    Gnss(#[from] GnssProblem),
}

/// What a robot receives, and how it is taken in.
#[derive(Clone, Debug)]
pub struct NativeStreams {
    /// The streams.
    pub streams: Vec<Stream>,
    /// The wheels.
    pub wheels: WheelIntake,
    /// The positions of GNSS.
    pub gnss: GnssIntake,
}

impl NativeStreams {
    /// Streams of which wheels are speeds of a differential drive, and positions in the frame of the map.
    pub fn new(streams: Vec<Stream>) -> Self {
        let wheels = WheelIntake::of(BaseKind::default(), None);
        Self { streams, wheels, gnss: GnssIntake::new(&GnssSensor::default()) }
    }
}

/// Subscriptions to the sensors of a robot, which end when this is dropped.
#[derive(Debug)]
pub struct NativeSensors {
    _subscribers: Vec<Subscriber<()>>,
}

impl NativeSensors {
    /// Subscribes to the IMU and the given streams of frames.
    ///
    /// Messages are parsed on Zenoh's threads and handed to `inputs`, which never waits; images are decoded elsewhere.
    ///
    /// # Errors
    /// [`NativeError`].
    pub fn subscribe(
        session: &zenoh::Session,
        runtime: &Handle,
        robot: &str,
        wanted: &NativeStreams,
        inputs: &LiveInputs,
    ) -> Result<Self, NativeError> {
        let mut subscribers = Vec::new();
        for stream in &wanted.streams {
            let key = match *stream {
                Stream::Camera(index) => keys::robot_camera(robot, index)?,
                Stream::Tracks => keys::robot_tracks(robot)?,
                Stream::Wheels => keys::robot_wheels(robot)?,
                Stream::Gnss => keys::robot_gnss(robot)?,
                _ => keys::robot_imu(robot)?,
            };
            let (stream, inputs) = (*stream, inputs.clone());
            let (wheels, gnss) = (Mutex::new(wanted.wheels.clone()), wanted.gnss);
            let take = move |sample: Sample| {
                let handed_in = match stream {
                    Stream::Wheels => {
                        let mut wheels = wheels.lock().unwrap_or_else(PoisonError::into_inner);
                        hand_in_wheels(&sample.payload().to_bytes(), &mut wheels, &inputs)
                    }
                    Stream::Gnss => hand_in_gnss(&sample.payload().to_bytes(), &gnss, &inputs),
                    _ => hand_in(stream, &sample, &inputs),
                };
                if let Err(refusal) = handed_in {
                    inputs.refuse(stream, refusal);
                }
            };
            let declared = runtime.block_on(async { session.declare_subscriber(&key).callback(take).await });
            subscribers.push(declared.map_err(|source| NativeError::Subscribe { key, source })?);
        }
        Ok(Self { _subscribers: subscribers })
    }
}

fn hand_in_wheels(payload: &[u8], intake: &mut WheelIntake, inputs: &LiveInputs) -> Result<(), Refusal> {
    for message in decode_wheels(payload)? {
        match intake.take(message.stamp_ns, &message.wheels)? {
            Some(reading) => inputs.wheels(reading),
            None => inputs.nothing(Stream::Wheels),
        }
    }
    Ok(())
}

fn hand_in_gnss(payload: &[u8], intake: &GnssIntake, inputs: &LiveInputs) -> Result<(), Refusal> {
    for message in decode_gnss(payload)? {
        let sigmas = message.sigma.map(Vector3::from);
        let covariance = sigmas.map(|sigmas| Matrix3::from_diagonal(&sigmas.component_mul(&sigmas)));
        inputs.gnss(intake.take(message.stamp_ns, &Vector3::from(message.position), covariance)?);
    }
    Ok(())
}

fn hand_in(stream: Stream, sample: &Sample, inputs: &LiveInputs) -> Result<(), Refusal> {
    match stream {
        Stream::Camera(camera) => {
            check_image_length(sample.payload().len())?;
            let header = ImageHeader::decode(sample.attachment().map(|bytes| bytes.to_bytes()).as_deref())?;
            let image = image(&header, sample.payload().to_bytes().into_owned())?;
            inputs.image(camera, header.stamp_ns, image);
        }
        Stream::Tracks => {
            let TracksMessage { stamp_ns, tracks, features } =
                TracksMessage::decode(&sample.payload().to_bytes())?;
            let observation = |(camera, feature_id, u, v)| TrackObservation {
                camera,
                feature_id,
                pixel: Vector2::new(u, v),
            };
            inputs.tracks(stamp_ns, tracks.into_iter().map(observation).collect(), features);
        }
        _ => {
            for reading in decode_imu(&sample.payload().to_bytes())? {
                let (gyroscope, accelerometer) =
                    (Vector3::from(reading.gyroscope), Vector3::from(reading.accelerometer));
                inputs.imu(ImuSample { stamp_ns: reading.stamp_ns, gyroscope, accelerometer });
            }
        }
    }
    Ok(())
}

fn image(header: &ImageHeader, bytes: Vec<u8>) -> Result<LiveImage, Refusal> {
    if matches!(header.encoding.as_str(), "jpeg" | "png") {
        return Ok(LiveImage::Encoded(bytes));
    }
    let encoding = &header.encoding;
    let Some(pixel_bytes) = RawImage::bytes_per_pixel(encoding) else {
        return Err(Refusal::Encoding(encoding.chars().take(32).collect()));
    };
    let (width, height, encoding) = (header.width, header.height, encoding.clone());
    let without_gaps = u64::from(width) * pixel_bytes as u64;
    let step = match header.step {
        Some(step) => step,
        None => u32::try_from(without_gaps).map_err(|_| Refusal::Step(without_gaps))?,
    };
    Ok(LiveImage::Raw(RawPixels { width, height, step, encoding, big_endian: false, bytes }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use sensors::live::{LiveSettings, LiveSource};
    use sensors::{Encoder, SensorCalibration, SensorEvent, SensorSource, WheelReadings};

    fn header(text: &str) -> ImageHeader {
        ImageHeader::decode(Some(text.as_bytes())).unwrap()
    }

    #[test]
    fn images_are_taken_in_the_documented_encodings_and_no_other() {
        let raw =
            image(&header(r#"{"stamp_ns": 1, "encoding": "bgr8", "width": 2, "height": 1}"#), vec![7; 6]);
        let gray = raw.unwrap().into_gray((2, 1)).unwrap();
        assert_eq!(gray.pixels(), [7, 7]);
        let jpeg = image(&header(r#"{"stamp_ns": 1, "encoding": "jpeg"}"#), vec![1, 2]).unwrap();
        assert_eq!(jpeg, LiveImage::Encoded(vec![1, 2]));
        let unknown = image(&header(r#"{"stamp_ns": 1, "encoding": "h264"}"#), Vec::new()).unwrap_err();
        assert!(unknown.to_string().contains("h264") && unknown.to_string().contains("mono8"), "{unknown}");
        let wide = header(r#"{"stamp_ns": 1, "encoding": "rgb8", "width": 4000000000, "height": 1}"#);
        assert!(image(&wide, Vec::new()).is_err());
    }

    #[test]
    fn wheels_and_gnss_are_handed_in_as_readings() {
        let mut settings = LiveSettings::images(&SensorCalibration::default());
        (settings.wheels, settings.gnss) = (Some(WheelReadings::Speeds), true);
        let (inputs, mut source) = LiveSource::new("test", SensorCalibration::default(), &settings);
        let mut counts = WheelIntake::of(BaseKind::Differential, Some(Encoder::new(100.0, 8).unwrap()));
        let rows = br#"[{"stamp_ns": 0, "wheels": [250, 3]}, {"stamp_ns": 100000000, "wheels": [4, 0]}]"#;
        hand_in_wheels(rows, &mut counts, &inputs).unwrap();
        let short = hand_in_wheels(br#"{"stamp_ns": 1, "wheels": [1]}"#, &mut counts, &inputs).unwrap_err();
        assert!(short.to_string().contains("1 numbers, but a differential base has 2"), "{short}");
        let intake = GnssIntake::new(&GnssSensor::default());
        let fix = br#"{"stamp_ns": 100000000, "position": [1, 2, 3], "sigma": [0.5, 0.5, 1]}"#;
        hand_in_gnss(fix, &intake, &inputs).unwrap();
        let without = hand_in_gnss(br#"{"stamp_ns": 5, "position": [1, 2, 3]}"#, &intake, &inputs);
        assert!(without.unwrap_err().to_string().contains("standard deviations"));
        inputs.close();
        let Some(SensorEvent::Wheels(reading)) = source.next().unwrap() else { panic!("wheels") };
        let per_count = std::f64::consts::TAU / 100.0 / 0.1;
        assert_eq!(reading.stamp_ns, 50_000_000);
        assert!((reading.values[0] - 10.0 * per_count).abs() < 1e-9, "{reading:?}");
        let Some(SensorEvent::Gnss(reading)) = source.next().unwrap() else { panic!("a position") };
        assert_eq!((reading.position, reading.covariance[(2, 2)]), (Vector3::new(1.0, 2.0, 3.0), 1.0));
        assert!(source.next().unwrap().is_none());
    }
}
