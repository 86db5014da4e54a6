//! Quality of service, as far as it shows in tokens.

/// Whether messages may be lost on a good network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reliability {
    /// Repeated until they arrive, as far as the transport does.
    Reliable,
    /// Sent once.
    BestEffort,
}

/// Which messages wait for a slow receiver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum History {
    /// The last ones, this many.
    KeepLast(usize),
    /// All. A reliable publisher waits where the network is congested.
    KeepAll,
}

/// Whether subscribers that come later get what was published before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Durability {
    /// They do not.
    Volatile,
    /// They get the last messages, as many as [`History`] keeps, from the publisher, as long as that exists.
    TransientLocal,
}

/// Quality of service of a topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Qos {
    /// Whether messages may be lost.
    pub reliability: Reliability,
    /// Whether subscribers that come later get what was published before.
    pub durability: Durability,
    /// Which messages wait for a slow receiver.
    pub history: History,
}

impl Qos {
    /// Reliable, the last 10: the default of `rclcpp`, RViz and Nav2 included.
    pub fn reliable() -> Self {
        Self::volatile(Reliability::Reliable, History::KeepLast(10))
    }

    /// Best effort, the last 5: ROS's profile of sensor data.
    pub fn sensor_data() -> Self {
        Self::volatile(Reliability::BestEffort, History::KeepLast(5))
    }

    /// Reliable, and no message is dropped: for recordings that are played.
    pub fn every_message() -> Self {
        Self::volatile(Reliability::Reliable, History::KeepAll)
    }

    /// Latched: reliable, and who comes later gets the last message. What `/tf_static` and maps have.
    pub fn latched() -> Self {
        Self {
            reliability: Reliability::Reliable,
            durability: Durability::TransientLocal,
            history: History::KeepLast(1),
        }
    }

    fn volatile(reliability: Reliability, history: History) -> Self {
        Self { reliability, durability: Durability::Volatile, history }
    }

    /// Messages that are kept for subscribers that come later.
    pub(crate) fn kept(&self) -> usize {
        match (self.durability, self.history) {
            (Durability::Volatile, _) => 0,
            (Durability::TransientLocal, History::KeepLast(depth)) => depth.max(1),
            (Durability::TransientLocal, History::KeepAll) => usize::MAX,
        }
    }

    /// Whether a publisher waits where the network is congested, as rmw_zenoh does.
    pub(crate) fn waits(&self) -> bool {
        *self == Self::every_message()
    }

    /// The text in tokens: reliability, durability, history and depth, deadline, lifespan,
    /// liveliness. Fields that have no value are infinite; no other is left out, since defaults have changed.
    ///
    /// ```
    /// assert_eq!(ros2::Qos::sensor_data().token(), "2:2:1,5:,:,:,,");
    /// assert_eq!(ros2::Qos::every_message().token(), "1:2:2,10:,:,:,,");
    /// assert_eq!(ros2::Qos::latched().token(), "1:1:1,1:,:,:,,");
    /// ```
    pub fn token(&self) -> String {
        let reliability = match self.reliability {
            Reliability::Reliable => 1,
            Reliability::BestEffort => 2,
        };
        let (history, depth) = match self.history {
            History::KeepLast(depth) => (1, depth),
            // The depth of ROS's default profile, which has no meaning then.
            History::KeepAll => (2, 10),
        };
        let durability = match self.durability {
            Durability::TransientLocal => 1,
            Durability::Volatile => 2,
        };
        format!("{reliability}:{durability}:{history},{depth}:,:,:,,")
    }
}
