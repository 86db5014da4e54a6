//! What a robot publishes, whichever topic it is of.

use crate::codec::{CodecError, Format, decode};
use crate::robot::{RobotOdometry, RobotPose, RobotStatus};

/// A message that a robot published.
#[derive(Clone, Debug)]
pub enum Published {
    /// Its pose in the map.
    Pose(Box<RobotPose>),
    /// Its odometry.
    Odometry(Box<RobotOdometry>),
    /// Its state.
    Status(RobotStatus),
}

impl Published {
    /// Last parts of the keys, `robot/{robot}/pose` and so on.
    pub const TOPICS: [&str; 3] = ["pose", "odometry", "status"];

    /// Reads a message.
    ///
    /// # Arguments
    /// * `key`: under which it was published: it ends with one of [`Published::TOPICS`].
    /// * `encoding`: as Zenoh states it.
    ///
    /// # Errors
    /// [`CodecError::UnknownFormat`], and those of [`decode`].
    pub fn decode(key: &str, encoding: &str, payload: &[u8]) -> Result<Published, CodecError> {
        let format =
            Format::from_encoding(encoding).ok_or_else(|| CodecError::UnknownFormat(encoding.to_owned()))?;
        match key.rsplit('/').next() {
            Some("pose") => decode(format, payload).map(|pose| Self::Pose(Box::new(pose))),
            Some("odometry") => decode(format, payload).map(|odometry| Self::Odometry(Box::new(odometry))),
            _ => decode(format, payload).map(Self::Status),
        }
    }
}
