//! Package `sensor_msgs`.

use crate::definition::{self, Definition};
use crate::geometry_msgs::{Quaternion, Vector3};
use crate::message::RosMessage;
use crate::std_msgs::Header;
use serde::{Deserialize, Serialize};

/// `sensor_msgs/msg/Imu`.
///
/// Covariances are 3x3 by rows; all zero means unknown, a first element of -1 that the value itself is not given.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Imu {
    /// Time and frame of the readings.
    pub header: Header,
    /// Orientation, if the device estimates it.
    pub orientation: Quaternion,
    /// rad^2.
    pub orientation_covariance: [f64; 9],
    /// rad/s.
    pub angular_velocity: Vector3,
    /// rad^2/s^2.
    pub angular_velocity_covariance: [f64; 9],
    /// Specific force, m/s^2.
    pub linear_acceleration: Vector3,
    /// m^2/s^4.
    pub linear_acceleration_covariance: [f64; 9],
}

impl RosMessage for Imu {
    const TYPE_NAME: &'static str = "sensor_msgs/msg/Imu";
    const TYPE_HASH: &'static str = "RIHS01_7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b";
    const DEFINITION: Definition = definition::IMU;
}

/// `sensor_msgs/msg/JointState`: what is not measured is an empty list.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct JointState {
    /// Time.
    pub header: Header,
    /// The joints, in the order of the lists below.
    pub name: Vec<String>,
    /// rad or m.
    pub position: Vec<f64>,
    /// rad/s or m/s.
    pub velocity: Vec<f64>,
    /// N m or N.
    pub effort: Vec<f64>,
}

impl RosMessage for JointState {
    const TYPE_NAME: &'static str = "sensor_msgs/msg/JointState";
    const TYPE_HASH: &'static str = "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e";
    const DEFINITION: Definition = definition::JOINT_STATE;
}

/// `sensor_msgs/msg/NavSatStatus`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct NavSatStatus {
    /// -2 unknown, -1 no position, 0 without corrections, 1 and 2 with those of satellites and of the ground.
    pub status: i8,
    /// Bits of the systems that are used.
    pub service: u16,
}

/// `sensor_msgs/msg/NavSatFix`: a position on WGS 84.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct NavSatFix {
    /// Time of the position, and the frame of the antenna.
    pub header: Header,
    /// Whether there is a position.
    pub status: NavSatStatus,
    /// Degrees north.
    pub latitude: f64,
    /// Degrees east.
    pub longitude: f64,
    /// Above the ellipsoid, metres; NaN where it is not known.
    pub altitude: f64,
    /// East, north and up, m^2, by rows.
    pub position_covariance: [f64; 9],
    /// 0 unknown, 1 approximated, 2 the diagonal, 3 all of it.
    pub position_covariance_type: u8,
}

impl RosMessage for NavSatFix {
    const TYPE_NAME: &'static str = "sensor_msgs/msg/NavSatFix";
    const TYPE_HASH: &'static str = "RIHS01_62223ab3fe210a15976021da7afddc9e200dc9ec75231c1b6a557fc598a65404";
    const DEFINITION: Definition = definition::NAV_SAT_FIX;
}

/// `sensor_msgs/msg/Image`: pixels by rows.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Image {
    /// Time of exposure and the camera's optical frame.
    pub header: Header,
    /// Rows.
    pub height: u32,
    /// Columns.
    pub width: u32,
    /// Channels, their meaning and size: `mono8`, `bgr8`, `bayer_rggb8`, ...
    pub encoding: String,
    /// 1 if channels of more than a byte are big endian.
    pub is_bigendian: u8,
    /// Bytes of a row with its padding.
    pub step: u32,
    /// `step * height` bytes.
    #[serde(with = "serde_bytes")]
    pub data: Vec<u8>,
}

impl RosMessage for Image {
    const TYPE_NAME: &'static str = "sensor_msgs/msg/Image";
    const TYPE_HASH: &'static str = "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47";
    const DEFINITION: Definition = definition::IMAGE;
}

/// `sensor_msgs/msg/CompressedImage`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct CompressedImage {
    /// Time of exposure and the camera's optical frame.
    pub header: Header,
    /// Begins with or ends in `jpeg` or `png`, for example `mono8; jpeg compressed `.
    pub format: String,
    /// An image file.
    #[serde(with = "serde_bytes")]
    pub data: Vec<u8>,
}

impl RosMessage for CompressedImage {
    const TYPE_NAME: &'static str = "sensor_msgs/msg/CompressedImage";
    const TYPE_HASH: &'static str = "RIHS01_15640771531571185e2efc8a100baf923961a4d15d5569652e6cb6691e8e371a";
    const DEFINITION: Definition = definition::COMPRESSED_IMAGE;
}

/// A part of a sensor's image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RegionOfInterest {
    /// Leftmost column.
    pub x_offset: u32,
    /// Topmost row.
    pub y_offset: u32,
    /// Rows; 0: all.
    pub height: u32,
    /// Columns; 0: all.
    pub width: u32,
    /// Whether rectified images are of this region.
    pub do_rectify: bool,
}

/// `sensor_msgs/msg/CameraInfo`. Matrices are by rows.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CameraInfo {
    /// Time of exposure and the camera's optical frame.
    pub header: Header,
    /// Rows at calibration.
    pub height: u32,
    /// Columns at calibration.
    pub width: u32,
    /// `plumb_bob`, `rational_polynomial` or `equidistant`.
    pub distortion_model: String,
    /// Distortion parameters.
    pub d: Vec<f64>,
    /// 3x3 intrinsics of the raw image; `k[0]` is 0 for a camera without calibration.
    pub k: [f64; 9],
    /// 3x3 rectification.
    pub r: [f64; 9],
    /// 3x4 projection of the rectified image; `p[3]` is -f b for the right camera of a pair.
    pub p: [f64; 12],
    /// Columns that are one pixel; 0 as 1.
    pub binning_x: u32,
    /// Rows that are one pixel; 0 as 1.
    pub binning_y: u32,
    /// Part of the full resolution, before binning.
    pub roi: RegionOfInterest,
}

impl RosMessage for CameraInfo {
    const TYPE_NAME: &'static str = "sensor_msgs/msg/CameraInfo";
    const TYPE_HASH: &'static str = "RIHS01_b3dfd68ff46c9d56c80fd3bd4ed22c7a4ddce8c8348f2f59c299e73118e7e275";
    const DEFINITION: Definition = definition::CAMERA_INFO;
}

/// A field of the points of a cloud.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PointField {
    /// For example `x`.
    pub name: String,
    /// Bytes from the begin of a point.
    pub offset: u32,
    /// [`PointField::FLOAT32`], or another number type of ROS.
    pub datatype: u8,
    /// Numbers in the field.
    pub count: u32,
}

impl PointField {
    /// 32-bit floats.
    pub const FLOAT32: u8 = 7;
}

/// `sensor_msgs/msg/PointCloud2`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PointCloud2 {
    /// Time and frame of the points.
    pub header: Header,
    /// Rows; 1 for a cloud without order.
    pub height: u32,
    /// Points of a row.
    pub width: u32,
    /// What a point consists of.
    pub fields: Vec<PointField>,
    /// Whether numbers are big-endian.
    pub is_bigendian: bool,
    /// Bytes of a point.
    pub point_step: u32,
    /// Bytes of a row.
    pub row_step: u32,
    /// The points, by rows.
    #[serde(with = "serde_bytes")]
    pub data: Vec<u8>,
    /// Whether all points are finite.
    pub is_dense: bool,
}

impl PointCloud2 {
    /// A cloud of points with the fields `x`, `y` and `z`, metres.
    ///
    /// ```
    /// use ros_messages::sensor_msgs::PointCloud2;
    ///
    /// let cloud = PointCloud2::of_points(Default::default(), &[[1.0, 2.0, 3.0]]);
    /// assert_eq!((cloud.width, cloud.point_step, cloud.data.len()), (1, 12, 12));
    /// ```
    pub fn of_points(header: Header, points: &[[f32; 3]]) -> Self {
        let field = |(name, offset): (&str, u32)| PointField {
            name: name.to_owned(),
            offset,
            datatype: PointField::FLOAT32,
            count: 1,
        };
        let point_step = 12;
        let width = points.len() as u32;
        Self {
            header,
            height: 1,
            width,
            fields: [("x", 0), ("y", 4), ("z", 8)].map(field).to_vec(),
            is_bigendian: false,
            point_step,
            row_step: point_step * width,
            data: points.iter().flatten().flat_map(|number| number.to_le_bytes()).collect(),
            is_dense: points.iter().flatten().all(|number| number.is_finite()),
        }
    }
}

impl RosMessage for PointCloud2 {
    const TYPE_NAME: &'static str = "sensor_msgs/msg/PointCloud2";
    const TYPE_HASH: &'static str = "RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5";
    const DEFINITION: Definition = definition::POINT_CLOUD;
}
