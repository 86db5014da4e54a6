//! Messages against the definitions of REP-103 and REP-105, and through a Zenoh session.

use super::messages::{Messages, map_tilt_deg, messages};
use super::odom_frame::OdomFrame;
use super::{BaseMount, InitialPoseTopic, RosBody, RosOutput, RosSettings};
use client::SessionOptions;
use client::session::{SessionMode, close_session, open_session};
use estimator::propagation::{ImuMatrix, ImuState};
use estimator::{Localization, Motion, Status};
use geometry::{Pose, PoseWithCovariance, rotation};
use nalgebra::{Matrix6, Quaternion, UnitQuaternion, Vector3, Vector6};
use robot::initial_pose::InitialPoses;
use robot::{Estimate, GlobalEstimate, Output as _, StatusReport};
use ros_messages::RosMessage;
use ros_messages::diagnostic_msgs::{DiagnosticArray, DiagnosticStatus};
use ros_messages::geometry_msgs::{self, PoseWithCovarianceStamped, TransformStamped};
use ros_messages::nav_msgs::{Odometry, Path};
use ros_messages::rosgraph_msgs::Clock;
use ros_messages::tf2_msgs::TFMessage;
use ros2::{Node, NodeOptions, Qos, Subscriber};
use sensors::Frame;
use std::time::Duration;

/// Settings with a robot frame that is turned and moved against the IMU.
pub fn settings() -> RosSettings {
    RosSettings {
        session: SessionOptions::default(),
        domain: 0,
        namespace: String::new(),
        body: RosBody {
            mount: BaseMount::known(pose([0.3, -0.7, 0.2], [0.5, -0.1, 0.4])),
            ..RosBody::default()
        },
        robot: "cart7".to_owned(),
        map_expected: true,
        has_clock: true,
        initial_pose: None,
    }
}

fn pose(turn: [f64; 3], translation: [f64; 3]) -> Pose {
    Pose::new(rotation::exp(&turn.into()), translation.into())
}

fn estimate() -> Estimate {
    let local_from_imu = pose([0.1, 0.2, 1.3], [4.0, 5.0, 0.6]);
    let global_from_local = pose([0.0, 0.0, -2.0], [10.0, 20.0, 0.0]);
    let covariance =
        Matrix6::from_fn(
            |row, column| if row == column { 1.0 + row as f64 } else { 0.01 * (row + column) as f64 },
        );
    let mut of_state = ImuMatrix::identity() * 0.01;
    of_state.fixed_view_mut::<6, 6>(0, 0).copy_from(&covariance);
    let motion = Motion {
        stamp_ns: 1_403_636_579_763_555_584,
        state: ImuState {
            local_from_imu,
            velocity: Vector3::new(1.0, -2.0, 0.5),
            gyroscope_bias: Vector3::zeros(),
            accelerometer_bias: Vector3::zeros(),
        },
        covariance: of_state,
        angular_velocity: Vector3::new(0.3, -0.4, 0.9),
        angular_velocity_variance: 0.001,
    };
    let global = GlobalEstimate {
        global_from_imu: PoseWithCovariance::new(global_from_local * local_from_imu, covariance),
        global_from_local: PoseWithCovariance::exact(global_from_local),
    };
    Estimate::new(motion, Some(global), true)
}

fn made(odom: &mut OdomFrame, estimate: &Estimate) -> Messages {
    messages(&settings().body, odom, estimate).unwrap()
}

fn read_pose(position: geometry_msgs::Vector3, orientation: geometry_msgs::Quaternion) -> Pose {
    let geometry_msgs::Quaternion { x, y, z, w } = orientation;
    Pose::new(UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)), <[f64; 3]>::from(position).into())
}

fn read_transform(transform: &TransformStamped) -> Pose {
    read_pose(transform.transform.translation, transform.transform.rotation)
}

fn assert_near(a: &Pose, b: &Pose) {
    assert!(a.local(b).norm() < 1e-9, "{a:?} is not {b:?}");
}

#[test]
fn transforms_lead_from_the_map_over_odom_to_the_robot() {
    let messages = made(&mut OdomFrame::default(), &estimate());
    let [odom_from_base, map_from_odom] = &messages.transforms.transforms[..] else {
        panic!("two transforms")
    };
    let names =
        |transform: &TransformStamped| (transform.header.frame_id.clone(), transform.child_frame_id.clone());
    assert_eq!(names(odom_from_base), ("odom".into(), "base_link".into()));
    assert_eq!(names(map_from_odom), ("map".into(), "odom".into()));
    let map_from_base = read_transform(map_from_odom) * read_transform(odom_from_base);
    let pose = messages.pose.unwrap();
    assert_eq!(pose.header.frame_id, "map");
    assert_eq!(pose.header.stamp.to_nanoseconds(), estimate().motion.stamp_ns);
    assert_near(&map_from_base, &read_pose(pose.pose.pose.position, pose.pose.pose.orientation));
    assert_near(
        &map_from_base,
        &(estimate().global.unwrap().global_from_imu.pose * settings().body.mount.imu_from_base()),
    );
}

#[test]
fn a_correction_by_the_map_moves_odom_in_the_map_and_not_the_robot_in_odom() {
    let mut odom = OdomFrame::default();
    let before = made(&mut odom, &estimate());
    let mut corrected = estimate();
    let global = corrected.global.as_mut().unwrap();
    global.global_from_local.pose = pose([0.0, 0.0, 1.0], [-3.0, 2.0, 1.0]);
    global.global_from_imu.pose = global.global_from_local.pose * corrected.motion.state.local_from_imu;
    let after = made(&mut odom, &corrected);
    assert_eq!(after.odometry, before.odometry);
    assert_eq!(after.transforms.transforms[0], before.transforms.transforms[0]);
    assert_ne!(after.transforms.transforms[1], before.transforms.transforms[1]);
}

#[test]
fn a_new_odometry_frame_of_the_estimator_does_not_move_the_robot() {
    let mut odom = OdomFrame::default();
    let before = made(&mut odom, &estimate());
    odom.restart();
    let mut restarted = estimate();
    // The new L has the yaw and the position of now for its origin; roll and pitch are those of gravity.
    let new_from_old = pose([0.0, 0.0, 0.8], [-7.0, 1.0, 2.0]);
    let local = restarted.motion.local_from_imu().change_of_parent(&new_from_old);
    restarted.motion.state.local_from_imu = local.pose;
    restarted.motion.covariance.fixed_view_mut::<6, 6>(0, 0).copy_from(&local.covariance);
    restarted.motion.state.velocity = new_from_old.rotation * restarted.motion.state.velocity;
    let global = restarted.global.as_mut().unwrap();
    global.global_from_local.pose = global.global_from_local.pose * new_from_old.inverse();
    let after = made(&mut odom, &restarted);
    for (new, old) in after.transforms.transforms.iter().zip(&before.transforms.transforms) {
        assert_near(&read_transform(new), &read_transform(old));
    }
    let covariances = after.odometry.pose.covariance.iter().zip(&before.odometry.pose.covariance);
    assert!(covariances.clone().all(|(new, old)| (new - old).abs() < 1e-9), "{covariances:?}");
}

/// The derivative of the robot's pose along the motion that the estimate states.
#[test]
fn the_twist_is_the_motion_of_the_robot_in_its_own_frame() {
    let (settings, estimate) = (settings(), estimate());
    let twist = made(&mut OdomFrame::default(), &estimate).odometry.twist.twist;
    let at = |seconds: f64| {
        let motion = &estimate.motion;
        let imu = motion.state.local_from_imu;
        let turned = imu.rotation * rotation::exp(&(motion.angular_velocity * seconds));
        Pose::new(turned, imu.translation + motion.state.velocity * seconds)
            * settings.body.mount.imu_from_base()
    };
    let step = 1e-6;
    let motion = at(-step).inverse() * at(step);
    let linear = at(0.0).rotation.inverse() * (at(step).translation - at(-step).translation) / (2.0 * step);
    let angular = motion.rotation.scaled_axis() / (2.0 * step);
    assert!((Vector3::from(<[f64; 3]>::from(twist.linear)) - linear).norm() < 1e-6);
    assert!((Vector3::from(<[f64; 3]>::from(twist.angular)) - angular).norm() < 1e-6);
}

/// REP-103 and `geometry_msgs/PoseWithCovariance`: x, y, z, then rotations about the fixed axes of the header's frame.
#[test]
fn the_covariance_is_that_of_the_robots_error_about_fixed_axes() {
    let estimate = estimate();
    let covariance = made(&mut OdomFrame::default(), &estimate).odometry.pose.covariance;
    // Errors of the IMU along each direction, and what they do to the robot.
    let root = estimate.motion.local_from_imu().covariance.cholesky().unwrap().l();
    let step = 1e-6;
    let base = |error: &Vector6<f64>| {
        let imu = estimate.motion.state.local_from_imu;
        let turned = rotation::exp(&error.fixed_rows::<3>(0).into_owned()) * imu.rotation;
        Pose::new(turned, imu.translation + error.fixed_rows::<3>(3)) * settings().body.mount.imu_from_base()
    };
    let mut expected = Matrix6::zeros();
    for column in 0..6 {
        let error: Vector6<f64> = root.column(column) * step;
        let (ahead, behind) = (base(&error), base(&-error));
        let position = (ahead.translation - behind.translation) / (2.0 * step);
        let turn = (ahead.rotation * behind.rotation.inverse()).scaled_axis() / (2.0 * step);
        let ros = Vector6::new(position.x, position.y, position.z, turn.x, turn.y, turn.z);
        expected += ros * ros.transpose();
    }
    for (at, value) in covariance.iter().enumerate() {
        let expected = expected[(at / 6, at % 6)];
        assert!((value - expected).abs() < 1e-6, "{at}: {value} is not {expected}");
    }
}

#[test]
fn before_the_map_is_known_and_where_the_robot_is_lost_there_is_odometry_only() {
    let before = Estimate::new(estimate().motion, None, true);
    let lost = Estimate::new(estimate().motion, estimate().global, false);
    for estimate in [before, lost] {
        let messages = made(&mut OdomFrame::default(), &estimate);
        assert_eq!(messages.pose, None);
        assert_eq!(messages.transforms.transforms.len(), 1);
        assert_eq!(messages.odometry.child_frame_id, "base_link");
    }
}

fn endpoint() -> String {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    format!("tcp/{}", listener.local_addr().unwrap())
}

fn status_report() -> StatusReport {
    let (localization, reason) = (Localization::Localized, "fine".to_owned());
    let status = Status { localization, reason, last_map_update_ns: None, held_keyframes: 3 };
    StatusReport::new(Some(estimate().motion.stamp_ns), status)
}

fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap()
}

async fn next<M: RosMessage + Send + 'static>(subscriber: &Subscriber<M>) -> M {
    let received = tokio::time::timeout(Duration::from_secs(20), subscriber.receive()).await;
    received.expect("in time").unwrap().message.unwrap()
}

#[test]
fn other_nodes_receive_all_topics() {
    let runtime = runtime();
    let endpoint = endpoint();
    let router = SessionOptions { listen: vec![endpoint.clone()], ..SessionOptions::default() };
    let router = runtime.block_on(open_session(&router)).unwrap();
    let options = NodeOptions { domain: 9, namespace: "cart7".into(), name: "rviz".into() };
    let node = runtime.block_on(Node::new(router.clone(), options)).unwrap();
    let (odometry, predicted, pose, transforms, diagnostics) = runtime.block_on(async {
        (
            node.subscriber::<Odometry>("odometry", Qos::reliable(), 10).await.unwrap(),
            node.subscriber::<Odometry>("odometry_predicted", Qos::sensor_data(), 10).await.unwrap(),
            node.subscriber::<PoseWithCovarianceStamped>("pose", Qos::reliable(), 10).await.unwrap(),
            node.subscriber::<TFMessage>("/tf", Qos::reliable(), 10).await.unwrap(),
            node.subscriber::<DiagnosticArray>("/diagnostics", Qos::reliable(), 10).await.unwrap(),
        )
    });
    let clock = runtime.block_on(node.subscriber::<Clock>("/clock", Qos::sensor_data(), 10)).unwrap();
    let path = runtime.block_on(node.subscriber::<Path>("path", Qos::reliable(), 10)).unwrap();
    let mut settings = settings();
    settings.session.connect = vec![endpoint];
    (settings.domain, settings.namespace) = (9, "cart7".into());
    let (mut output, task) = RosOutput::start(settings, runtime.handle()).unwrap();
    output.status(&status_report());
    let diagnosed = runtime.block_on(next(&diagnostics));
    assert_eq!(
        (diagnosed.status[0].level, diagnosed.status[0].hardware_id.as_str()),
        (DiagnosticStatus::OK, "cart7")
    );
    output.estimate(&estimate());
    let expected = made(&mut OdomFrame::default(), &estimate());
    assert_eq!(runtime.block_on(next(&odometry)), expected.odometry);
    assert_eq!(runtime.block_on(next(&clock)).clock, expected.odometry.header.stamp);
    let driven = runtime.block_on(next(&path));
    let pose_of_path = driven.poses.first().map(|pose| (&pose.header, pose.pose));
    assert_eq!(pose_of_path, expected.pose.as_ref().map(|pose| (&pose.header, pose.pose.pose)));
    assert_eq!(Some(runtime.block_on(next(&pose))), expected.pose);
    assert_eq!(runtime.block_on(next(&transforms)), expected.transforms);
    let mut motion = estimate().motion;
    motion.stamp_ns += 5_000_000;
    motion.state.local_from_imu.translation.x += 0.01;
    output.predicted().unwrap()(&motion);
    let mut later = estimate();
    later.motion = motion;
    assert_eq!(runtime.block_on(next(&predicted)), made(&mut OdomFrame::default(), &later).odometry);
    // What is queued at the end is sent, with the stamps of the sensors.
    output.set_clock_shift(3_600_000_000_000);
    output.estimate(&estimate());
    drop(output);
    runtime.block_on(task.finish());
    let mut shifted = estimate();
    shifted.motion.stamp_ns += 3_600_000_000_000;
    assert_eq!(runtime.block_on(next(&odometry)), made(&mut OdomFrame::default(), &shifted).odometry);
    runtime.block_on(close_session(&router));
}

#[test]
fn where_sensors_are_mounted_arrives_at_nodes_that_come_later_and_poses_of_operators_arrive_here() {
    let (runtime, endpoint) = (runtime(), endpoint());
    let router = SessionOptions { listen: vec![endpoint.clone()], ..SessionOptions::default() };
    let router = runtime.block_on(open_session(&router)).unwrap();
    let mut settings = settings();
    settings.session.connect = vec![endpoint];
    let poses = InitialPoses::default();
    settings.initial_pose = Some(InitialPoseTopic { topic: "/initialpose".to_owned(), poses: poses.clone() });
    let body_from_imu = settings.body.mount.imu_from_base().inverse();
    let (mut output, task) = RosOutput::start(settings, runtime.handle()).unwrap();
    output.publish_mounting(&[]);
    output.status(&status_report());
    let node = runtime.block_on(Node::new(router.clone(), NodeOptions::default())).unwrap();
    let diagnostics =
        runtime.block_on(node.subscriber::<DiagnosticArray>("/diagnostics", Qos::reliable(), 10)).unwrap();
    // It is published by now.
    runtime.block_on(next(&diagnostics));
    runtime.block_on(next(&diagnostics));
    let late = runtime.block_on(node.subscriber::<TFMessage>("/tf_static", Qos::latched(), 10)).unwrap();
    let transforms = runtime.block_on(next(&late)).transforms;
    let [transform] = &transforms[..] else { panic!("one transform") };
    assert_eq!((transform.header.frame_id.as_str(), transform.child_frame_id.as_str()), ("base_link", "imu"));
    assert_near(&read_transform(transform), &body_from_imu);

    let operator = runtime
        .block_on(node.publisher::<PoseWithCovarianceStamped>("/initialpose", Qos::reliable()))
        .unwrap();
    let mut message = PoseWithCovarianceStamped::default();
    message.header.frame_id = "map".to_owned();
    message.pose.pose.position.x = 7.0;
    for (index, variance) in [(0, 0.25), (7, 0.25), (35, 0.07)] {
        message.pose.covariance[index] = variance;
    }
    let set = runtime.block_on(async {
        for _ in 0..200 {
            operator.publish(&message).await.unwrap();
            tokio::time::sleep(Duration::from_millis(50)).await;
            if let Some(set) = poses.take() {
                return set;
            }
        }
        panic!("no pose arrived")
    });
    let expected = Pose::new(rotation::exp(&Vector3::zeros()), Vector3::x() * 7.0) * body_from_imu;
    assert_near(&set.unwrap().pose, &expected);
    drop(output);
    runtime.block_on(task.finish());
    runtime.block_on(close_session(&router));
}

#[test]
fn without_a_router_estimates_are_dropped_and_the_run_ends() {
    let runtime = runtime();
    let mut settings = settings();
    settings.session.connect = vec![endpoint()];
    settings.session.mode = Some(SessionMode::Client);
    let (mut output, task) = RosOutput::start(settings, runtime.handle()).unwrap();
    for _ in 0..1000 {
        output.estimate(&estimate());
        output.status(&status_report());
    }
    drop(output);
    runtime.block_on(task.finish());
}

#[test]
fn a_status_is_as_old_as_the_last_image() {
    let runtime = runtime();
    let mut settings = settings();
    settings.session.connect = vec![endpoint()];
    settings.session.mode = Some(SessionMode::Client);
    let (mut output, task) = RosOutput::start(settings, runtime.handle()).unwrap();
    let last_image = |output: &RosOutput| output.diagnostics.borrow().as_ref().map(|last| last.last_image);
    output.frame(&Frame::default());
    output.status(&status_report());
    let first = last_image(&output);
    std::thread::sleep(Duration::from_millis(5));
    output.status(&status_report());
    assert_eq!(last_image(&output), first);
    output.frame(&Frame::default());
    output.status(&status_report());
    assert!(last_image(&output) > first);
    drop(output);
    runtime.block_on(task.finish());
}

#[test]
fn a_namespace_that_ros_does_not_allow_is_refused() {
    let mut settings = settings();
    settings.namespace = "cart-7".into();
    let error = RosOutput::start(settings, runtime().handle()).unwrap_err();
    assert!(error.to_string().contains("cart-7"), "{error}");
}

#[test]
fn a_map_is_level_where_its_z_axis_is_up_in_the_odometry_frame() {
    let tilt_of = |turn: [f64; 3], is_usable: bool| {
        let mut tilted = estimate();
        let translation = [10.0, 20.0, 0.0];
        tilted.global.as_mut().unwrap().global_from_local =
            PoseWithCovariance::exact(pose(turn, translation));
        tilted.is_usable = is_usable;
        map_tilt_deg(&tilted)
    };
    assert_eq!(tilt_of([0.0, 0.0, -2.0], true), None);
    assert_eq!(tilt_of([0.08, 0.0, 0.0], true), None);
    let tilt_deg = tilt_of([0.0, 0.2, 0.0], true).unwrap();
    assert!((tilt_deg - 0.2_f64.to_degrees()).abs() < 1e-9, "{tilt_deg}");
    assert_eq!(tilt_of([0.0, 0.2, 0.0], false), None, "lost");
}
