//! In place of the ROS 2 topics, in a build without ROS.

use robot::Output;
use sensors::CameraSensor;
use std::convert::Infallible;

/// There are none.
#[derive(Clone, Debug)]
pub struct RosOutput(Infallible);

impl RosOutput {
    pub(crate) fn publish_mounting(&mut self, _: &[CameraSensor]) {
        match self.0 {}
    }
}

impl Output for RosOutput {}
