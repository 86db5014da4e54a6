//! What the publishers of a topic offer, by their tokens.

use super::error::RosError;
use super::liveliness::publishers_of;
use super::names::absolute_topic;
use super::node::Node;
use super::qos::Reliability;

impl Node {
    /// The reliability that each publisher of a topic offers now; empty where none is seen.
    ///
    /// # Arguments
    /// * `topic`: below the node's namespace unless it begins with `/`.
    ///
    /// # Errors
    /// [`RosError`]: a name that ROS does not allow, or a session that is closed.
    pub async fn offers(&self, topic: &str) -> Result<Vec<Reliability>, RosError> {
        let topic = absolute_topic(&self.identity().namespace, topic)?;
        let tokens = self.tokens(&publishers_of(self.identity().domain, &topic)).await?;
        Ok(tokens.iter().map(|token| reliability_of(token)).collect())
    }
}

/// The reliability in the token of a publisher: the first number of its last part. What is left out is ROS's default.
fn reliability_of(token: &str) -> Reliability {
    let qos = token.rsplit('/').next().unwrap_or_default();
    match qos.split(':').next() {
        Some("2") => Reliability::BestEffort,
        _ => Reliability::Reliable,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Qos;
    use crate::liveliness::{Endpoint, NodeIdentity, TopicIdentity};

    #[test]
    fn a_token_says_what_its_publisher_offers() {
        let node = NodeIdentity {
            domain: 3,
            session: "a1".to_owned(),
            number: 0,
            namespace: "/".to_owned(),
            name: "camera".to_owned(),
        };
        let offered = |qos: Qos| {
            let topic = TopicIdentity {
                endpoint: Endpoint::Publisher,
                topic: "/cam0/image_raw",
                type_name: "sensor_msgs/msg/Image",
                type_hash: "RIHS01_0",
                qos,
            };
            reliability_of(&node.topic_token(1, &topic))
        };
        assert_eq!(offered(Qos::sensor_data()), Reliability::BestEffort);
        assert_eq!(offered(Qos::reliable()), Reliability::Reliable);
        assert_eq!(offered(Qos::latched()), Reliability::Reliable);
        assert_eq!(
            reliability_of("@ros2_lv/0/a1/0/1/MP/%/%/camera/%imu/type/hash/::,10:,:,:,,"),
            Reliability::Reliable
        );
    }
}
