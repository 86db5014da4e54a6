//! In place of the ROS 2 topics, in a build without ROS.

use super::estimate::Estimate;
use crate::outputs::QueryCounts;
use estimator::{Motion, Status};
use geometry::PoseWithCovariance;
use sensors::CameraSensor;
use std::convert::Infallible;

/// There are none.
#[derive(Clone, Debug)]
pub struct RosOutput(Infallible);

impl RosOutput {
    pub(crate) fn publish_mounting(&self, _: &[CameraSensor]) {
        match self.0 {}
    }

    pub(crate) fn publish(&mut self, _: &Estimate) {
        match self.0 {}
    }

    pub(crate) fn predicted(&self) -> Option<fn(&Motion)> {
        match self.0 {}
    }

    pub(crate) fn correct(&mut self, _: &PoseWithCovariance, _: &PoseWithCovariance) {
        match self.0 {}
    }

    pub(crate) fn set_clock_shift(&mut self, _: i64) {
        match self.0 {}
    }

    pub(crate) fn publish_status(&self, _: i64, _: &Status, _: QueryCounts) {
        match self.0 {}
    }

    pub(crate) fn restart(&mut self) {
        match self.0 {}
    }
}
