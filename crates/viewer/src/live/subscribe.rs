//! What robots publish on Zenoh.

use crate::error::ViewerError;
use crate::server::Viewer;
use protocol::{Published, keys};
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
    for topic in Published::TOPICS {
        let viewer = Arc::clone(viewer);
        let callback = move |sample: Sample| note_sample(&viewer, &sample);
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

fn note_sample(viewer: &Viewer, sample: &Sample) {
    let key = sample.key_expr().as_str();
    let Some(robot) = keys::robot_of(key).filter(|_| sample.kind() == SampleKind::Put) else { return };
    match Published::decode(key, &sample.encoding().to_string(), &sample.payload().to_bytes()) {
        Ok(published) => viewer.live.note_published(robot, published),
        Err(error) => tracing::debug!(key, "not shown: {error}"),
    }
}

/// A robot, or one of its sessions, is there or gone.
fn note_token(viewer: &Viewer, sample: &Sample) {
    let is_there = sample.kind() == SampleKind::Put;
    let key = sample.key_expr().as_str();
    let Some(robot) = keys::robot_of(key) else { return };
    match key.split('/').nth(3) {
        Some(session) => viewer.live.note_session(session, robot, is_there),
        None => viewer.live.note_online(robot, is_there),
    }
}
