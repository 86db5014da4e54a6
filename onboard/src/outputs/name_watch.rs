//! Finds other robots of the same name on the network.
//!
//! The topics of two robots of one name are mixed: subscribers get the poses of both as one robot's. Each robot declares
//! a token with the id of its session, and watches for tokens of its name. A robot is warned, and not stopped: the token
//! of a robot that lost power stays for some seconds, and must not keep it from starting again.

use super::publisher_error::PublisherError;
use protocol::keys;
use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, PoisonError};
use zenoh::Session;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::sample::{Sample, SampleKind};

/// Robots of the same name that are kept and told: whoever makes up more makes up all.
const MAX_NAMESAKES: usize = 16;

/// Watches for robots of the same name.
#[derive(Debug)]
pub(super) struct NameWatch {
    token: LivelinessToken,
    _watching: Subscriber<()>,
    namesakes: Arc<Mutex<BTreeSet<String>>>,
}

impl NameWatch {
    /// Declares `robot/{robot}/session/{id}`, and watches the others.
    pub(super) async fn start(session: &Session, robot: &str) -> Result<Self, PublisherError> {
        let prefix = format!("{}/session", keys::robot(robot)?);
        let own = format!("{prefix}/{}", session.zid());
        let namesakes = Arc::new(Mutex::new(BTreeSet::new()));
        let (seen, robot, own_key) = (Arc::clone(&namesakes), robot.to_owned(), own.clone());
        let note = move |sample: Sample| {
            let key = sample.key_expr().as_str();
            if sample.kind() != SampleKind::Put || key == own_key {
                return;
            }
            let mut seen = seen.lock().unwrap_or_else(PoisonError::into_inner);
            if seen.len() < MAX_NAMESAKES && seen.insert(key.to_owned()) {
                tracing::error!(
                    "another robot of the name \"{robot}\" is on this network: subscribers take the poses of both for one \
                     robot's; give each robot a name of its own with --robot NAME"
                );
            }
        };
        let liveliness = session.liveliness();
        // Tokens that are there come while this waits: a channel that is full would block it for ever.
        let watching =
            liveliness.declare_subscriber(format!("{prefix}/*")).history(true).callback(note).await;
        let watching = watching.map_err(PublisherError::Liveliness)?;
        let token = liveliness.declare_token(own).await.map_err(PublisherError::Liveliness)?;
        Ok(Self { token, _watching: watching, namesakes })
    }

    /// Number of other robots that were seen so far.
    pub(super) fn namesakes(&self) -> usize {
        self.namesakes.lock().unwrap_or_else(PoisonError::into_inner).len()
    }

    /// Ends the watch and undeclares the token.
    pub(super) async fn stop(self) {
        if let Err(error) = self.token.undeclare().await {
            tracing::debug!(%error, "the token of the session was gone with it");
        }
    }
}
