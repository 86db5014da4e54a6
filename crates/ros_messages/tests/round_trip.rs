//! What was written is read again, whatever the values, lengths and alignments.

use proptest::prelude::*;
use ros_messages::builtin_interfaces::Time;
use ros_messages::diagnostic_msgs::{DiagnosticArray, DiagnosticStatus, KeyValue};
use ros_messages::geometry_msgs::{
    Pose, PoseStamped, PoseWithCovariance, PoseWithCovarianceStamped, Quaternion, Transform,
    TransformStamped, Twist, TwistWithCovariance, Vector3,
};
use ros_messages::nav_msgs::{MapMetaData, OccupancyGrid, Odometry, Path};
use ros_messages::rosgraph_msgs::Clock;
use ros_messages::sensor_msgs::{CameraInfo, CompressedImage, Image, Imu, PointCloud2, RegionOfInterest};
use ros_messages::std_msgs::Header;
use ros_messages::tf2_msgs::TFMessage;
use ros_messages::{RosMessage, decode, encode};

prop_compose! {
    fn headers()(sec in any::<i32>(), nanosec in 0..1_000_000_000_u32, frame_id in ".{0,9}") -> Header {
        Header { stamp: Time { sec, nanosec }, frame_id }
    }
}

prop_compose! {
    fn vectors()(values in any::<[f64; 3]>()) -> Vector3 { values.into() }
}

prop_compose! {
    fn quaternions()([x, y, z, w] in any::<[f64; 4]>()) -> Quaternion { Quaternion { x, y, z, w } }
}

prop_compose! {
    fn poses()(position in vectors(), orientation in quaternions(), seed in any::<f64>()) -> PoseWithCovariance {
        let covariance = std::array::from_fn(|element| seed + element as f64);
        PoseWithCovariance { pose: Pose { position, orientation }, covariance }
    }
}

fn survives<M: RosMessage + PartialEq + std::fmt::Debug>(message: &M) {
    let bytes = encode(message).expect("encodes");
    assert_eq!(&decode::<M>(&bytes).expect("decodes"), message);
    // Middlewares round the length up.
    let padded = [bytes.as_slice(), &[0; 3]].concat();
    assert_eq!(&decode::<M>(&padded).expect("decodes with padding"), message);
}

proptest! {
    #[test]
    fn odometry(header in headers(), child_frame_id in ".{0,9}", pose in poses(), twist in poses()) {
        let velocity = Twist { linear: twist.pose.position, angular: pose.pose.position };
        let twist = TwistWithCovariance { twist: velocity, covariance: twist.covariance };
        survives(&PoseWithCovarianceStamped { header: header.clone(), pose });
        survives(&Odometry { header, child_frame_id, pose, twist });
    }

    #[test]
    fn paths_and_maps(header in headers(), poses in prop::collection::vec((headers(), poses()), 0..4), data in prop::collection::vec(any::<i8>(), 0..99),
                      points in prop::collection::vec(any::<[f32; 3]>(), 0..9), resolution in any::<f32>()) {
        let poses: Vec<PoseStamped> = poses.into_iter().map(|(header, pose)| PoseStamped { header, pose: pose.pose }).collect();
        let origin = poses.first().map(|pose| pose.pose).unwrap_or_default();
        let info = MapMetaData { map_load_time: header.stamp, resolution, width: 7, height: data.len() as u32, origin };
        survives(&Clock { clock: header.stamp });
        survives(&Path { header: header.clone(), poses });
        survives(&OccupancyGrid { header: header.clone(), info, data });
        survives(&PointCloud2::of_points(header, &points));
    }

    #[test]
    fn transforms(frames in prop::collection::vec((headers(), ".{0,9}", vectors(), quaternions()), 0..4)) {
        let transforms = frames.into_iter().map(|(header, child_frame_id, translation, rotation)| TransformStamped {
            header, child_frame_id, transform: Transform { translation, rotation },
        }).collect();
        survives(&TFMessage { transforms });
    }

    #[test]
    fn diagnostics(header in headers(), texts in prop::collection::vec((".{0,9}", ".{0,9}", any::<u8>()), 0..4)) {
        let status = texts.iter().map(|(name, message, level)| DiagnosticStatus {
            level: *level, name: name.clone(), message: message.clone(), hardware_id: name.clone(),
            values: texts.iter().map(|(key, value, _)| KeyValue { key: key.clone(), value: value.clone() }).collect(),
        }).collect();
        survives(&DiagnosticArray { header, status });
    }

    #[test]
    fn imu(header in headers(), orientation in quaternions(), values in any::<[[f64; 9]; 3]>(), vectors in any::<[[f64; 3]; 2]>()) {
        survives(&Imu {
            header, orientation, orientation_covariance: values[0],
            angular_velocity: vectors[0].into(), angular_velocity_covariance: values[1],
            linear_acceleration: vectors[1].into(), linear_acceleration_covariance: values[2],
        });
    }

    #[test]
    fn images(header in headers(), text in ".{0,9}", sizes in any::<[u32; 3]>(), data in prop::collection::vec(any::<u8>(), 0..99)) {
        let [height, width, step] = sizes;
        survives(&CompressedImage { header: header.clone(), format: text.clone(), data: data.clone() });
        survives(&Image { header, height, width, encoding: text, is_bigendian: 1, step, data });
    }

    #[test]
    fn camera_info(header in headers(), distortion_model in ".{0,9}", sizes in any::<[u32; 4]>(),
                   d in prop::collection::vec(any::<f64>(), 0..9), k in any::<[f64; 9]>(), p in any::<[f64; 12]>(), do_rectify in any::<bool>()) {
        let [height, width, binning_x, binning_y] = sizes;
        let roi = RegionOfInterest { x_offset: height, y_offset: width, height: binning_x, width: binning_y, do_rectify };
        survives(&CameraInfo { header, height, width, distortion_model, d, k, r: k, p, binning_x, binning_y, roi });
    }

    #[test]
    fn times(stamp_ns in (i64::from(i32::MIN) * 1_000_000_000)..=(i64::from(i32::MAX) * 1_000_000_000 + 999_999_999)) {
        let time = Time::from_nanoseconds(stamp_ns).expect("in range");
        prop_assert!(time.nanosec < 1_000_000_000);
        prop_assert_eq!(time.to_nanoseconds(), stamp_ns);
    }
}

#[test]
fn times_that_ros_cannot_write_are_none() {
    assert_eq!(Time::from_nanoseconds(i64::MAX), None);
    assert_eq!(Time::from_nanoseconds(i64::MIN), None);
}
