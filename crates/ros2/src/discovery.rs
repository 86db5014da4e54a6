//! What other nodes publish and subscribe to, by their tokens, and why a topic is not heard.

use super::error::RosError;
use super::liveliness::Endpoint;
use super::node::Node;
use std::collections::BTreeSet;
use std::fmt::Write as _;

/// The tokens of all nodes of all domains.
const ALL_TOKENS: &str = "@ros2_lv/**";
/// So many other topics are listed.
const MAX_LISTED: usize = 8;

/// A topic that a node publishes or subscribes to.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct DiscoveredTopic {
    /// Domain of the node.
    pub domain: u32,
    /// What the node does.
    pub endpoint: Endpoint,
    /// Absolute name.
    pub topic: String,
    /// For example `sensor_msgs/msg/Imu`.
    pub type_name: String,
    /// `RIHS01_...`.
    pub type_hash: String,
}

impl DiscoveredTopic {
    /// The topic of a token; `None` for the token of a node, or of something else.
    ///
    /// ```
    /// let token = "@ros2_lv/7/aa/0/4/MP/%/%/driver/%imu/sensor_msgs::msg::dds_::Imu_/RIHS01_0/1:2:2,10:,:,:,,";
    /// let found = ros2::DiscoveredTopic::of_token(token).unwrap();
    /// assert_eq!((found.domain, found.topic.as_str()), (7, "/imu"));
    /// assert_eq!(found.type_name, "sensor_msgs/msg/Imu");
    /// ```
    pub fn of_token(token: &str) -> Option<Self> {
        let parts: Vec<&str> = token.split('/').collect();
        let ["@ros2_lv", domain, _, _, _, kind, _, _, _, topic, type_name, type_hash, _] = parts.as_slice()
        else {
            return None;
        };
        let endpoint = match *kind {
            "MP" => Endpoint::Publisher,
            "MS" => Endpoint::Subscriber,
            _ => return None,
        };
        Some(Self {
            domain: domain.parse().ok()?,
            endpoint,
            topic: topic.replace('%', "/"),
            type_name: type_name.replacen("::dds_::", "::", 1).trim_end_matches('_').replace("::", "/"),
            type_hash: (*type_hash).to_owned(),
        })
    }
}

impl Node {
    /// The topics that nodes of any domain publish and subscribe to now, those of this node among them.
    ///
    /// # Errors
    /// [`RosError`]: the session is closed.
    pub async fn discover(&self) -> Result<Vec<DiscoveredTopic>, RosError> {
        let tokens = self.tokens(ALL_TOKENS).await?;
        // A topic that several nodes publish counts once.
        let found: BTreeSet<_> = tokens.iter().filter_map(|token| DiscoveredTopic::of_token(token)).collect();
        Ok(found.into_iter().collect())
    }
}

/// Why nothing comes from a topic, or nobody takes it, in a sentence, and which topics could be meant.
///
/// # Arguments
/// * `found`: what [`Node::discover`] finds.
/// * `wanted`: the other end of the topic as it would have to be.
///
/// ```
/// use ros2::{DiscoveredTopic, explain_silence, liveliness::Endpoint};
///
/// let imu = |domain| DiscoveredTopic {
///     domain,
///     endpoint: Endpoint::Publisher,
///     topic: "/imu".to_owned(),
///     type_name: "sensor_msgs/msg/Imu".to_owned(),
///     type_hash: "RIHS01_0".to_owned(),
/// };
/// let why = explain_silence(&[imu(7)], &imu(0));
/// assert_eq!(why, "/imu exists in domain 7, not in 0");
/// ```
pub fn explain_silence(found: &[DiscoveredTopic], wanted: &DiscoveredTopic) -> String {
    let DiscoveredTopic { domain, endpoint, topic, type_name, type_hash } = wanted;
    let others: Vec<&DiscoveredTopic> = found.iter().filter(|other| other.endpoint == *endpoint).collect();
    let does = if *endpoint == Endpoint::Publisher { "publishes" } else { "subscribes to" };
    let named = || others.iter().filter(|other| other.topic == *topic);
    if let Some(here) = named().find(|other| other.domain == *domain) {
        if here.type_name != *type_name {
            return format!("{topic} is of type {}, not of {type_name}", here.type_name);
        }
        // A subscriber takes only the version of the type that it was built with.
        return if *endpoint == Endpoint::Subscriber && here.type_hash != *type_hash {
            format!("{topic} is subscribed to with another version of {type_name} ({})", here.type_hash)
        } else {
            format!("a node {does} {topic} in domain {domain}, without a message so far")
        };
    }
    if let Some(elsewhere) = named().next() {
        return format!("{topic} exists in domain {}, not in {domain}", elsewhere.domain);
    }
    let mut why = format!("no node {does} {topic}");
    let of_type: Vec<_> = others.iter().filter(|other| other.type_name == *type_name).collect();
    if of_type.is_empty() {
        let _ = write!(why, ", nor any topic of type {type_name}");
        return why;
    }
    let _ = write!(why, "; topics of type {type_name} are");
    for (number, other) in of_type.iter().take(MAX_LISTED).enumerate() {
        let _ = write!(why, "{} {}", if number == 0 { "" } else { "," }, other.topic);
        if other.domain != *domain {
            let _ = write!(why, " (domain {})", other.domain);
        }
    }
    why
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::liveliness::{NodeIdentity, TopicIdentity};
    use crate::qos::Qos;

    fn topic(domain: u32, name: &str, type_name: &str) -> DiscoveredTopic {
        DiscoveredTopic {
            domain,
            endpoint: Endpoint::Publisher,
            topic: name.to_owned(),
            type_name: type_name.to_owned(),
            type_hash: "RIHS01_1".to_owned(),
        }
    }

    #[test]
    fn the_token_of_a_topic_says_what_it_was_made_of() {
        let node = NodeIdentity {
            domain: 3,
            session: "ab".to_owned(),
            number: 0,
            namespace: "/robot".to_owned(),
            name: "driver".to_owned(),
        };
        let made = topic(3, "/robot/cam0/image_raw", "sensor_msgs/msg/Image");
        let token = node.topic_token(
            5,
            &TopicIdentity {
                endpoint: made.endpoint,
                topic: &made.topic,
                type_name: &made.type_name,
                type_hash: &made.type_hash,
                qos: Qos::sensor_data(),
            },
        );
        assert_eq!(DiscoveredTopic::of_token(&token), Some(made));
        assert_eq!(DiscoveredTopic::of_token(&node.token()), None);
        assert_eq!(DiscoveredTopic::of_token("@adv/pub/1/2"), None);
    }

    #[test]
    fn every_reason_of_silence_is_named() {
        let (imu, image) = ("sensor_msgs/msg/Imu", "sensor_msgs/msg/Image");
        let wanted = topic(0, "/imu", imu);
        let why = |found: &[DiscoveredTopic]| explain_silence(found, &wanted);
        assert!(why(&[topic(0, "/imu", image)]).contains("is of type sensor_msgs/msg/Image"));
        assert!(why(&[topic(0, "/imu", imu)]).contains("without a message"));
        assert!(why(&[topic(7, "/imu", imu), topic(0, "/odd", imu)]).contains("domain 7, not in 0"));
        let listed = why(&[topic(0, "/imu0", imu), topic(2, "/imu1", imu), topic(0, "/cam", image)]);
        assert!(listed.ends_with("are /imu0, /imu1 (domain 2)"), "{listed}");
        let nothing = why(&[DiscoveredTopic { endpoint: Endpoint::Subscriber, ..wanted.clone() }]);
        assert_eq!(nothing, "no node publishes /imu, nor any topic of type sensor_msgs/msg/Imu");
        let taken = DiscoveredTopic { endpoint: Endpoint::Subscriber, ..wanted.clone() };
        let old = DiscoveredTopic { type_hash: "RIHS01_2".to_owned(), ..taken.clone() };
        assert!(explain_silence(&[old], &taken).contains("another version"));
    }
}
