//! Says why nothing comes from the topics of ROS 2 sensors.

use ros_messages::RosMessage;
use ros2::liveliness::Endpoint;
use ros2::{DiscoveredTopic, Node, RosError, explain_silence};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::task::JoinHandle;

/// Topics that are silent for so long are looked for, again and again.
const LOOK: Duration = Duration::from_secs(4);

/// The topics that messages are expected from.
#[derive(Debug, Default)]
pub(crate) struct TopicWatch {
    topics: Vec<(DiscoveredTopic, Arc<AtomicBool>)>,
}

impl TopicWatch {
    /// Expects messages from a topic; whoever receives them sets the flag.
    pub(crate) fn expect<M: RosMessage>(
        &mut self,
        node: &Node,
        topic: &str,
    ) -> Result<Arc<AtomicBool>, RosError> {
        let heard = Arc::new(AtomicBool::new(false));
        self.topics.push((node.counterpart::<M>(Endpoint::Publisher, topic)?, Arc::clone(&heard)));
        Ok(heard)
    }

    /// Watches until something has come from every topic.
    pub(crate) fn start(mut self, node: Arc<Node>) -> JoinHandle<()> {
        tokio::spawn(async move {
            loop {
                tokio::time::sleep(LOOK).await;
                self.topics.retain(|(_, heard)| !heard.load(Ordering::Relaxed));
                if self.topics.is_empty() {
                    return;
                }
                let Ok(found) = node.discover().await else { return };
                for (wanted, _) in &self.topics {
                    let why = explain_silence(&found, wanted);
                    tracing::warn!(topic = wanted.topic, domain = wanted.domain, "no sensor data: {why}");
                }
            }
        })
    }
}
