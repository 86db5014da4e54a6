//! Quality of service, as far as it shows in tokens.

/// Whether messages may be lost on a good network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reliability {
    /// Repeated until they arrive, as far as the transport does.
    Reliable,
    /// Sent once.
    BestEffort,
}

/// Quality of service of a topic: volatile, and the last messages are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Qos {
    /// Whether messages may be lost.
    pub reliability: Reliability,
    /// Number of messages that wait for a slow receiver.
    pub depth: usize,
}

impl Qos {
    /// Reliable, the last 10: what `rclcpp` uses where nothing else is said, RViz and Nav2 included.
    pub fn reliable() -> Self {
        Self { reliability: Reliability::Reliable, depth: 10 }
    }

    /// Best effort, the last 5: ROS's profile of sensor data.
    pub fn sensor_data() -> Self {
        Self { reliability: Reliability::BestEffort, depth: 5 }
    }

    /// The text in tokens: reliability, durability (volatile), history (keep last) and depth, deadline, lifespan,
    /// liveliness. Fields that have no value are infinite; no other is left out, since defaults have changed.
    ///
    /// ```
    /// assert_eq!(ros2::Qos::sensor_data().token(), "2:2:1,5:,:,:,,");
    /// ```
    pub fn token(&self) -> String {
        let reliability = match self.reliability {
            Reliability::Reliable => 1,
            Reliability::BestEffort => 2,
        };
        format!("{reliability}:2:1,{}:,:,:,,", self.depth)
    }
}
