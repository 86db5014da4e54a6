//! Readings, images and projections as messages of ROS, and back.

pub use crate::camera_info::{camera_info_message, camera_info_topic, camera_of_info, has_ros_name};
pub use crate::ros_gnss::{
    GNSS_TOPIC, NoFix, SatellitePosition, position_message, position_of_message, satellite_position,
};
pub use crate::ros_sensors::{RosSensors, transform_message};
pub use crate::ros_wheels::{
    JointReader, MovesSideways, WHEEL_TOPIC, WheelJoints, base_velocity, wheel_message,
};
pub use crate::static_transforms::StaticTransforms;

use crate::{ImageData, ImuSample, OriginalImage, RawPixels};
use nalgebra::Vector3;
use ros_messages::sensor_msgs::{CompressedImage, Image, Imu};
use ros_messages::std_msgs::Header;
use ros_messages::{CdrError, encode};
use std::borrow::Cow;
use vision::{GrayImage, ImageError};

/// The driver says that it does not measure something.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the driver gives no {0} (covariance[0] is -1, and the values are zero)")]
pub struct NotMeasured(pub &'static str);

/// The reading that a message holds; its values may be not finite.
///
/// By the definition of the message, -1 in the covariance says that there is no value; many drivers write it for a covariance
/// that they do not know. Values that are not zero are taken for what they are.
///
/// # Errors
/// [`NotMeasured`]: angular velocity or acceleration is not given.
///
/// ```
/// use ros_messages::sensor_msgs::Imu;
/// let mut message = Imu::default();
/// message.angular_velocity.z = 0.5;
/// assert_eq!(sensors::ros::imu_sample(&message)?.gyroscope.z, 0.5);
/// # Ok::<(), sensors::ros::NotMeasured>(())
/// ```
pub fn imu_sample(message: &Imu) -> Result<ImuSample, NotMeasured> {
    let vector = |vector| Vector3::from(<[f64; 3]>::from(vector));
    let gyroscope = vector(message.angular_velocity);
    let accelerometer = vector(message.linear_acceleration);
    // Exactly -1 by the definition of the message.
    #[allow(clippy::float_cmp)]
    let is_missing =
        |value: &Vector3<f64>, covariance: &[f64; 9]| covariance[0] == -1.0 && *value == Vector3::zeros();
    if is_missing(&gyroscope, &message.angular_velocity_covariance) {
        return Err(NotMeasured("angular velocity"));
    }
    if is_missing(&accelerometer, &message.linear_acceleration_covariance) {
        return Err(NotMeasured("acceleration"));
    }
    Ok(ImuSample { stamp_ns: message.header.stamp.to_nanoseconds(), gyroscope, accelerometer })
}

/// A reading as a message, without orientation; `None` for a time that ROS cannot write (before 1901, after 2038).
///
/// # Arguments
/// * `frame`: name of the IMU's frame.
pub fn imu_message(reading: &ImuSample, frame: &str) -> Option<Imu> {
    let mut message = Imu {
        header: Header::new(reading.stamp_ns, frame)?,
        angular_velocity: <[f64; 3]>::from(reading.gyroscope).into(),
        linear_acceleration: <[f64; 3]>::from(reading.accelerometer).into(),
        ..Imu::default()
    };
    message.orientation_covariance[0] = -1.0;
    Some(message)
}

/// An image as a message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ImageMessage {
    /// Pixels.
    Raw(Image),
    /// The bytes of a PNG or JPEG file.
    Compressed(CompressedImage),
}

impl ImageMessage {
    /// The topic of a camera's images in this form.
    pub fn topic(&self, camera: usize) -> String {
        match self {
            Self::Raw(_) => format!("/cam{camera}/image_raw"),
            Self::Compressed(_) => format!("/cam{camera}/image_raw/compressed"),
        }
    }

    /// As CDR.
    ///
    /// # Errors
    /// [`CdrError`].
    pub fn encode(&self) -> Result<Vec<u8>, CdrError> {
        match self {
            Self::Raw(image) => encode(image),
            Self::Compressed(image) => encode(image),
        }
    }
}

/// An image as a message, as the sensor gave it: a JPEG or PNG byte by byte, pixels in their own encoding, and grey pixels
/// where there is nothing else; `None` for a time that ROS cannot write.
///
/// # Errors
/// [`ImageError`]: it cannot be read or decoded.
pub fn image_message(
    image: &ImageData,
    stamp_ns: i64,
    frame: &str,
) -> Result<Option<ImageMessage>, ImageError> {
    let Some(header) = Header::new(stamp_ns, frame) else { return Ok(None) };
    Ok(Some(match image.original()?.map(Cow::into_owned) {
        Some(OriginalImage::Encoded(data)) => {
            let format = file_format(&data).to_owned();
            ImageMessage::Compressed(CompressedImage { header, format, data })
        }
        Some(OriginalImage::Raw(RawPixels { width, height, step, encoding, big_endian, bytes: data })) => {
            let is_bigendian = u8::from(big_endian);
            ImageMessage::Raw(Image { header, height, width, encoding, is_bigendian, step, data })
        }
        None => ImageMessage::Raw(pixels_message(image.read()?.as_ref(), header)),
    }))
}

/// What a file of an image is, in the words of `sensor_msgs/CompressedImage`. Without a word about the pixels
/// image_transport takes their channels from the file.
fn file_format(bytes: &[u8]) -> &'static str {
    if bytes.starts_with(b"\x89PNG") { "png" } else { "jpeg" }
}

/// Grey pixels as a message.
pub fn pixels_message(image: &GrayImage, header: Header) -> Image {
    let (width, height) = (image.width() as u32, image.height() as u32);
    let (encoding, data) = ("mono8".to_owned(), image.pixels().to_vec());
    Image { header, height, width, encoding, is_bigendian: 0, step: width, data }
}
