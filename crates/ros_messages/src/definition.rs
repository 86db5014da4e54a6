//! The definitions of the messages, as recordings carry them (`ros2msg`): their fields, and those of the types in them.

use crate::message::RosMessage;
use std::fmt::Write as _;

/// A type and its fields, a line each.
type Fields = (&'static str, &'static str);

const TIME: Fields = ("builtin_interfaces/Time", "int32 sec\nuint32 nanosec\n");
const HEADER: Fields = ("std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id\n");
const VECTOR3: Fields = ("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z\n");
const POINT: Fields = ("geometry_msgs/Point", "float64 x\nfloat64 y\nfloat64 z\n");
const QUATERNION: Fields =
    ("geometry_msgs/Quaternion", "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n");
const POSE: Fields =
    ("geometry_msgs/Pose", "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n");
const POSE_WITH_COVARIANCE: Fields =
    ("geometry_msgs/PoseWithCovariance", "geometry_msgs/Pose pose\nfloat64[36] covariance\n");
const TWIST: Fields =
    ("geometry_msgs/Twist", "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n");
const TWIST_WITH_COVARIANCE: Fields =
    ("geometry_msgs/TwistWithCovariance", "geometry_msgs/Twist twist\nfloat64[36] covariance\n");
const TRANSFORM: Fields =
    ("geometry_msgs/Transform", "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n");
const TRANSFORM_STAMPED: Fields = (
    "geometry_msgs/TransformStamped",
    "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n",
);
const KEY_VALUE: Fields = ("diagnostic_msgs/KeyValue", "string key\nstring value\n");
const DIAGNOSTIC_STATUS: Fields = (
    "diagnostic_msgs/DiagnosticStatus",
    "byte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\nbyte level\nstring name\nstring message\nstring hardware_id\n\
     diagnostic_msgs/KeyValue[] values\n",
);
const REGION_OF_INTEREST: Fields = (
    "sensor_msgs/RegionOfInterest",
    "uint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\nbool do_rectify\n",
);

const NAV_SAT_STATUS: Fields = (
    "sensor_msgs/NavSatStatus",
    "int8 STATUS_UNKNOWN=-2\nint8 STATUS_NO_FIX=-1\nint8 STATUS_FIX=0\nint8 STATUS_SBAS_FIX=1\nint8 STATUS_GBAS_FIX=2\n\
     uint16 SERVICE_UNKNOWN=0\nuint16 SERVICE_GPS=1\nuint16 SERVICE_GLONASS=2\nuint16 SERVICE_COMPASS=4\n\
     uint16 SERVICE_GALILEO=8\nint8 status\nuint16 service\n",
);
const POSE_STAMPED_FIELDS: Fields =
    ("geometry_msgs/PoseStamped", "std_msgs/Header header\ngeometry_msgs/Pose pose\n");
const MAP_META_DATA: Fields = (
    "nav_msgs/MapMetaData",
    "builtin_interfaces/Time map_load_time\nfloat32 resolution\nuint32 width\nuint32 height\ngeometry_msgs/Pose origin\n",
);
const POINT_FIELD: Fields = (
    "sensor_msgs/PointField",
    "uint8 INT8=1\nuint8 UINT8=2\nuint8 INT16=3\nuint8 UINT16=4\nuint8 INT32=5\nuint8 UINT32=6\nuint8 FLOAT32=7\n\
     uint8 FLOAT64=8\nstring name\nuint32 offset\nuint8 datatype\nuint32 count\n",
);

pub(crate) const CLOCK: Definition = Definition { fields: "builtin_interfaces/Time clock\n", types: &[TIME] };
pub(crate) const PATH: Definition = Definition {
    fields: "std_msgs/Header header\ngeometry_msgs/PoseStamped[] poses\n",
    types: &[HEADER, TIME, POSE_STAMPED_FIELDS, POSE, POINT, QUATERNION],
};
pub(crate) const OCCUPANCY_GRID: Definition = Definition {
    fields: "std_msgs/Header header\nnav_msgs/MapMetaData info\nint8[] data\n",
    types: &[HEADER, TIME, MAP_META_DATA, POSE, POINT, QUATERNION],
};
pub(crate) const POINT_CLOUD: Definition = Definition {
    fields: "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\nbool is_bigendian\n\
             uint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense\n",
    types: &[HEADER, TIME, POINT_FIELD],
};
pub(crate) const ODOMETRY: Definition = Definition {
    fields: "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n\
             geometry_msgs/TwistWithCovariance twist\n",
    types: &[
        HEADER,
        TIME,
        POSE_WITH_COVARIANCE,
        POSE,
        POINT,
        QUATERNION,
        TWIST_WITH_COVARIANCE,
        TWIST,
        VECTOR3,
    ],
};
pub(crate) const POSE_STAMPED: Definition = Definition {
    fields: "std_msgs/Header header\ngeometry_msgs/PoseWithCovariance pose\n",
    types: &[HEADER, TIME, POSE_WITH_COVARIANCE, POSE, POINT, QUATERNION],
};
pub(crate) const TRANSFORMS: Definition = Definition {
    fields: "geometry_msgs/TransformStamped[] transforms\n",
    types: &[TRANSFORM_STAMPED, HEADER, TIME, TRANSFORM, VECTOR3, QUATERNION],
};
pub(crate) const DIAGNOSTICS: Definition = Definition {
    fields: "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status\n",
    types: &[HEADER, TIME, DIAGNOSTIC_STATUS, KEY_VALUE],
};
pub(crate) const IMU: Definition = Definition {
    fields: "std_msgs/Header header\ngeometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n\
             geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n\
             geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance\n",
    types: &[HEADER, TIME, QUATERNION, VECTOR3],
};
pub(crate) const JOINT_STATE: Definition = Definition {
    fields: "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n",
    types: &[HEADER, TIME],
};
pub(crate) const NAV_SAT_FIX: Definition = Definition {
    fields: "uint8 COVARIANCE_TYPE_UNKNOWN=0\nuint8 COVARIANCE_TYPE_APPROXIMATED=1\nuint8 COVARIANCE_TYPE_DIAGONAL_KNOWN=2\n\
             uint8 COVARIANCE_TYPE_KNOWN=3\nstd_msgs/Header header\nsensor_msgs/NavSatStatus status\nfloat64 latitude\n\
             float64 longitude\nfloat64 altitude\nfloat64[9] position_covariance\nuint8 position_covariance_type\n",
    types: &[HEADER, TIME, NAV_SAT_STATUS],
};
pub(crate) const IMAGE: Definition = Definition {
    fields: "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\n\
             uint8[] data\n",
    types: &[HEADER, TIME],
};
pub(crate) const COMPRESSED_IMAGE: Definition =
    Definition { fields: "std_msgs/Header header\nstring format\nuint8[] data\n", types: &[HEADER, TIME] };
pub(crate) const CAMERA_INFO: Definition = Definition {
    fields: "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\nfloat64[9] k\n\
             float64[9] r\nfloat64[12] p\nuint32 binning_x\nuint32 binning_y\nsensor_msgs/RegionOfInterest roi\n",
    types: &[HEADER, TIME, REGION_OF_INTEREST],
};

/// The definition of a type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Definition {
    /// Its fields in the language of ROS 2, a line each.
    fields: &'static str,
    /// The types of its fields, and of theirs.
    types: &'static [Fields],
}

/// The definition of a message with those of all types in it, as recordings carry it under the name `ros2msg`.
pub fn definition<M: RosMessage>() -> String {
    let mut text = M::DEFINITION.fields.to_owned();
    for (name, fields) in M::DEFINITION.types {
        let _ = write!(text, "{}\nMSG: {name}\n{fields}", "=".repeat(80));
    }
    text
}
