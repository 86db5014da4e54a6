//! Messages of robots, their sessions among them, and errors.

use super::values::*;
use proptest::collection::vec;
use proptest::option;
use proptest::prelude::*;
use protocol::*;

pub fn robot_poses() -> impl Strategy<Value = RobotPose> {
    (any::<i64>(), names(), any::<u64>(), identities(), poses(), poses()).prop_map(
        |(stamp_ns, map, map_version, map_identity, global_from_imu, global_from_local)| RobotPose {
            stamp_ns,
            map,
            map_version,
            map_identity,
            global_from_imu,
            global_from_local,
        },
    )
}

pub fn robot_odometries() -> impl Strategy<Value = RobotOdometry> {
    (any::<i64>(), poses(), points(), points()).prop_map(
        |(stamp_ns, local_from_imu, velocity_in_local, angular_velocity_in_imu)| RobotOdometry {
            stamp_ns,
            local_from_imu,
            velocity_in_local,
            angular_velocity_in_imu,
        },
    )
}

pub fn robot_statuses() -> impl Strategy<Value = RobotStatus> {
    let states = vec![
        RobotState::OdometryOnly,
        RobotState::Localized,
        RobotState::Lost,
        RobotState::Starting,
        RobotState::Off,
    ];
    let numbers = (any::<u32>(), any::<u64>(), any::<u64>());
    (
        any::<i64>(),
        prop::sample::select(states),
        ".{0,40}",
        option::of(names()),
        option::of(any::<i64>()),
        numbers,
    )
        .prop_map(
            |(
                stamp_ns,
                state,
                reason,
                map,
                last_map_update_ns,
                (keyframes_held, queries_sent, queries_answered),
            )| {
                RobotStatus {
                    stamp_ns,
                    state,
                    reason,
                    map,
                    last_map_update_ns,
                    keyframes_held,
                    queries_sent,
                    queries_answered,
                }
            },
        )
}

pub fn error_replies() -> impl Strategy<Value = ErrorReply> {
    let codes = vec![
        ErrorCode::BadRequest,
        ErrorCode::SchemaMismatch,
        ErrorCode::DescriptorMismatch,
        ErrorCode::UnknownMap,
        ErrorCode::UnknownKeyframe,
        ErrorCode::Busy,
        ErrorCode::Internal,
    ];
    (prop::sample::select(codes), ".{0,40}").prop_map(|(code, message)| ErrorReply::new(code, message))
}

pub fn session_parts() -> impl Strategy<Value = SessionPart> {
    (0..1_000_000_u64, any::<[u8; 32]>(), vec(any::<u8>(), 0..300), 0..1000_u64).prop_map(
        |(offset, digest, bytes, more)| SessionPart {
            total_bytes: offset + bytes.len() as u64 + more + 1,
            digest,
            offset,
            bytes,
        },
    )
}

pub fn session_part_replies() -> impl Strategy<Value = SessionPartReply> {
    (0..=MAX_SESSION_BYTES, any::<bool>())
        .prop_map(|(received_bytes, is_complete)| SessionPartReply { received_bytes, is_complete })
}
