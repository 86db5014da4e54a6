//! The tokens by which nodes and topics are discovered.
//!
//! ```text
//! @ros2_lv/<domain>/<session>/<node>/<entity>/<NN|MP|MS>/<enclave>/<namespace>/<name>[/<topic>/<type>/<hash>/<qos>]
//! ```
//!
//! A `/` within a part is written `%`, and no part is empty. The entity of a node is its own number.

use super::names::dds_type;
use super::qos::Qos;
use twox_hash::XxHash3_128;

/// Length of a publisher's id.
pub const GID_BYTES: usize = 16;

/// A node of a session.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodeIdentity {
    /// Domain, `ROS_DOMAIN_ID`.
    pub domain: u32,
    /// Id of the Zenoh session, as Zenoh writes it.
    pub session: String,
    /// Number of the node in its session.
    pub number: u64,
    /// Absolute namespace.
    pub namespace: String,
    /// Name.
    pub name: String,
}

/// What a node does with a topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Endpoint {
    /// Publishes.
    Publisher,
    /// Subscribes.
    Subscriber,
}

/// A topic of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TopicIdentity<'a> {
    /// What the node does.
    pub endpoint: Endpoint,
    /// Absolute name.
    pub topic: &'a str,
    /// For example `sensor_msgs/msg/Imu`.
    pub type_name: &'a str,
    /// `RIHS01_...`.
    pub type_hash: &'a str,
    /// Quality of service.
    pub qos: Qos,
}

impl NodeIdentity {
    /// The token of the node.
    pub fn token(&self) -> String {
        self.entity(self.number, "NN")
    }

    /// The token of a topic of the node.
    ///
    /// # Arguments
    /// * `entity`: its number in the session; not that of another topic or node.
    pub fn topic_token(&self, entity: u64, topic: &TopicIdentity<'_>) -> String {
        let kind = match topic.endpoint {
            Endpoint::Publisher => "MP",
            Endpoint::Subscriber => "MS",
        };
        let (name, type_name) = (mangled(topic.topic), dds_type(topic.type_name));
        format!("{}/{name}/{type_name}/{}/{}", self.entity(entity, kind), topic.type_hash, topic.qos.token())
    }

    fn entity(&self, entity: u64, kind: &str) -> String {
        let Self { domain, session, number, namespace, name } = self;
        // The enclave is the root: SROS keystores are not supported.
        format!(
            "@ros2_lv/{domain}/{session}/{number}/{entity}/{kind}/%/{}/{}",
            mangled(namespace),
            mangled(name)
        )
    }
}

/// The tokens of all publishers of a topic, a key expression.
///
/// # Arguments
/// * `topic`: its absolute name.
pub(crate) fn publishers_of(domain: u32, topic: &str) -> String {
    // Session, node and entity; enclave, namespace and name; type, hash and quality of service.
    format!("@ros2_lv/{domain}/*/*/*/MP/*/*/*/{}/*/*/*", mangled(topic))
}

fn mangled(name: &str) -> String {
    if name.is_empty() { "%".to_owned() } else { name.replace('/', "%") }
}

/// The id of a publisher: XXH3-128 of its token, low 64 bits first.
pub fn gid(token: &str) -> [u8; GID_BYTES] {
    XxHash3_128::oneshot(token.as_bytes()).to_le_bytes()
}
