//! What robots publish on Zenoh.

use super::robot::Published;
use crate::error::ViewerError;
use crate::server::Viewer;
use protocol::{CodecError, Format, Message, keys};
use std::sync::Arc;
use zenoh::Session;
use zenoh::pubsub::Subscriber;
use zenoh::sample::{Sample, SampleKind};

/// Follows robots until it is dropped.
pub struct RobotFollower {
    _subscribers: Vec<Subscriber<()>>,
}

/// Shows all robots of a session's namespace as they publish.
///
/// # Errors
/// [`ViewerError::Zenoh`], as of a closed session.
pub async fn follow_robots(viewer: &Arc<Viewer>, session: &Session) -> Result<RobotFollower, ViewerError> {
    let mut subscribers = Vec::new();
    for topic in ["pose", "odometry", "status"] {
        let viewer = Arc::clone(viewer);
        let callback = move |sample: Sample| note_sample(&viewer, topic, &sample);
        let declared = session.declare_subscriber(format!("robot/*/{topic}")).callback(callback).await;
        subscribers.push(declared.map_err(ViewerError::Zenoh)?);
    }
    for tokens in ["robot/*", "robot/*/session/*"] {
        let viewer = Arc::clone(viewer);
        let callback = move |sample: Sample| note_token(&viewer, &sample);
        let declared = session.liveliness().declare_subscriber(tokens).history(true).callback(callback).await;
        subscribers.push(declared.map_err(ViewerError::Zenoh)?);
    }
    Ok(RobotFollower { _subscribers: subscribers })
}

fn note_sample(viewer: &Viewer, topic: &str, sample: &Sample) {
    let key = sample.key_expr().as_str();
    let Some(robot) = key.split('/').nth(1).filter(|name| keys::validate_name(name).is_ok()) else { return };
    if sample.kind() != SampleKind::Put {
        return;
    }
    let published = match topic {
        "pose" => decode(sample).map(|pose| Published::Pose(Box::new(pose))),
        "odometry" => decode(sample).map(|odometry| Published::Odometry(Box::new(odometry))),
        _ => decode(sample).map(Published::Status),
    };
    match published {
        Ok(published) => viewer.live.note_published(robot, published),
        Err(error) => tracing::debug!(key, "not shown: {error}"),
    }
}

fn decode<M: Message>(sample: &Sample) -> Result<M, CodecError> {
    let encoding = sample.encoding().to_string();
    let format = Format::from_encoding(&encoding).ok_or(CodecError::UnknownFormat(encoding))?;
    protocol::decode(format, &sample.payload().to_bytes())
}

/// A robot, or one of its sessions, is there or gone.
fn note_token(viewer: &Viewer, sample: &Sample) {
    let is_there = sample.kind() == SampleKind::Put;
    let mut chunks = sample.key_expr().as_str().split('/').skip(1);
    let Some(robot) = chunks.next().filter(|name| keys::validate_name(name).is_ok()) else { return };
    match chunks.nth(1) {
        Some(session) => viewer.live.note_session(session, robot, is_there),
        None => viewer.live.note_online(robot, is_there),
    }
}
