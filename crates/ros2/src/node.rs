//! A node.

use super::discovery::DiscoveredTopic;
use super::error::RosError;
use super::history::PublishedHistory;
use super::liveliness::{Endpoint, NodeIdentity, TopicIdentity, gid};
use super::names::{absolute_namespace, absolute_topic, check_node, data_key};
use super::publisher::Publisher;
use super::qos::{Durability, Qos};
use super::subscriber::Subscriber;
use ros_messages::RosMessage;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::sync::mpsc::unbounded_channel;
use zenoh::Session;
use zenoh::liveliness::LivelinessToken;
use zenoh::qos::CongestionControl;

/// Tokens that have not come by then are not waited for.
const TOKEN_TIMEOUT: Duration = Duration::from_secs(1);

/// What a node is called.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodeOptions {
    /// Domain, `ROS_DOMAIN_ID`: nodes of other domains are not seen.
    pub domain: u32,
    /// Namespace of the node, and of topics that do not begin with `/`.
    pub namespace: String,
    /// Name; letters, digits and `_`.
    pub name: String,
}

impl Default for NodeOptions {
    /// The node `/driftless` in domain 0.
    fn default() -> Self {
        Self { domain: 0, namespace: "/".to_owned(), name: "driftless".to_owned() }
    }
}

/// A node: other nodes see it, its publishers and its subscribers as long as they exist. One for each session.
///
/// The session's Zenoh namespace must be that of the other nodes, which is none where nothing is configured.
#[derive(Debug)]
pub struct Node {
    session: Session,
    identity: NodeIdentity,
    next_entity: AtomicU64,
    _token: LivelinessToken,
}

impl Node {
    /// Announces a node over an open session.
    ///
    /// # Errors
    /// [`RosError`]: a name that ROS does not allow, or a session that is closed.
    pub async fn new(session: Session, options: NodeOptions) -> Result<Self, RosError> {
        check_node(&options.name)?;
        let identity = NodeIdentity {
            domain: options.domain,
            session: session.zid().to_string(),
            number: 0,
            namespace: absolute_namespace(&options.namespace)?,
            name: options.name,
        };
        let token = declare(&session, identity.token()).await?;
        Ok(Self { session, identity, next_entity: AtomicU64::new(1), _token: token })
    }

    /// Announces a publisher.
    ///
    /// # Arguments
    /// * `topic`: below the node's namespace unless it begins with `/`.
    ///
    /// # Errors
    /// As [`Node::new`].
    pub async fn publisher<M: RosMessage>(&self, topic: &str, qos: Qos) -> Result<Publisher<M>, RosError> {
        let topic = absolute_topic(&self.identity.namespace, topic)?;
        let entity = self.next_entity();
        let token = self.topic_token::<M>(entity, Endpoint::Publisher, &topic, qos);
        let key = data_key(self.identity.domain, &topic, M::TYPE_NAME, M::TYPE_HASH);
        let congestion = if qos.waits() { CongestionControl::Block } else { CongestionControl::Drop };
        let publisher = self.session.declare_publisher(key.clone()).congestion_control(congestion).await;
        let publisher = publisher.map_err(RosError::zenoh("the publisher cannot be declared"))?;
        let history = match qos.durability {
            Durability::TransientLocal => {
                Some(PublishedHistory::declare(&self.session, &key, entity, qos.kept()).await?)
            }
            Durability::Volatile => None,
        };
        let gid = gid(&token);
        Ok(Publisher::new(publisher, history, declare(&self.session, token).await?, gid))
    }

    /// Announces a subscriber of any version of a type.
    ///
    /// # Arguments
    /// * `topic`: below the node's namespace unless it begins with `/`.
    /// * `capacity`: messages that wait to be received; the oldest are dropped for newer ones.
    ///
    /// # Errors
    /// As [`Node::new`].
    pub async fn subscriber<M: RosMessage + Send + 'static>(
        &self,
        topic: &str,
        qos: Qos,
        capacity: usize,
    ) -> Result<Subscriber<M>, RosError> {
        let topic = absolute_topic(&self.identity.namespace, topic)?;
        let token = self.topic_token::<M>(self.next_entity(), Endpoint::Subscriber, &topic, qos);
        let key = data_key(self.identity.domain, &topic, M::TYPE_NAME, "*");
        let subscriber = Subscriber::declare(&self.session, key, capacity, qos.durability).await?;
        Ok(subscriber.announced(declare(&self.session, token).await?))
    }

    /// The other end of a topic of this node, as it would have to be.
    ///
    /// # Errors
    /// [`RosError`]: a name that ROS does not allow.
    pub fn counterpart<M: RosMessage>(
        &self,
        endpoint: Endpoint,
        topic: &str,
    ) -> Result<DiscoveredTopic, RosError> {
        Ok(DiscoveredTopic {
            domain: self.identity.domain,
            endpoint,
            topic: absolute_topic(&self.identity.namespace, topic)?,
            type_name: M::TYPE_NAME.to_owned(),
            type_hash: M::TYPE_HASH.to_owned(),
        })
    }

    /// The tokens of a pattern that are seen now.
    pub(crate) async fn tokens(&self, pattern: &str) -> Result<Vec<String>, RosError> {
        // Those that this session knows come while it asks: a channel that is full would block it for ever.
        let (tell, mut found) = unbounded_channel();
        let asked = self.session.liveliness().get(pattern).timeout(TOKEN_TIMEOUT);
        let asked = asked.callback(move |reply| _ = tell.send(reply)).await;
        asked.map_err(RosError::zenoh("other nodes cannot be looked for"))?;
        let mut tokens = Vec::new();
        while let Some(reply) = found.recv().await {
            if let Ok(token) = reply.result() {
                tokens.push(token.key_expr().to_string());
            }
        }
        Ok(tokens)
    }

    pub(crate) fn identity(&self) -> &NodeIdentity {
        &self.identity
    }

    fn next_entity(&self) -> u64 {
        self.next_entity.fetch_add(1, Ordering::Relaxed)
    }

    fn topic_token<M: RosMessage>(&self, entity: u64, endpoint: Endpoint, topic: &str, qos: Qos) -> String {
        let (type_name, type_hash) = (M::TYPE_NAME, M::TYPE_HASH);
        self.identity.topic_token(entity, &TopicIdentity { endpoint, topic, type_name, type_hash, qos })
    }
}

async fn declare(session: &Session, token: String) -> Result<LivelinessToken, RosError> {
    let declared = session.liveliness().declare_token(token).await;
    declared.map_err(RosError::zenoh("the liveliness token cannot be declared"))
}
