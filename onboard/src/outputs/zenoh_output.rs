//! What a robot publishes over Zenoh, from the moment on that it is connected.

use super::publisher::Publisher;
use protocol::Format;
use robot::{Connection, Estimate, Output, PublishMotion, RunError, RunReport, StatusReport};
use std::error::Error;

/// A [`Publisher`] that begins when the robot's session is open.
#[derive(Debug)]
pub struct ZenohOutput {
    format: Format,
    clock_shift_ns: i64,
    publisher: Option<Publisher>,
}

impl ZenohOutput {
    /// Publishes nothing yet.
    ///
    /// # Arguments
    /// * `format`: of all messages.
    pub fn new(format: Format) -> Self {
        Self { format, clock_shift_ns: 0, publisher: None }
    }
}

impl Output for ZenohOutput {
    fn connect(&mut self, connection: &Connection<'_>) -> Result<(), Box<dyn Error + Send + Sync>> {
        let Connection { session, runtime, robot, map, .. } = *connection;
        let mut publisher = Publisher::new(session.clone(), runtime, robot, map, self.format)?;
        publisher.set_clock_shift(self.clock_shift_ns);
        self.publisher = Some(publisher);
        Ok(())
    }

    fn estimate(&mut self, estimate: &Estimate) {
        if let Some(publisher) = &self.publisher {
            publisher.publish(estimate);
        }
    }

    fn status(&mut self, report: &StatusReport) {
        if let Some(publisher) = &self.publisher {
            publisher.publish_status(report);
        }
    }

    fn predicted(&self) -> Option<PublishMotion> {
        let publisher = self.publisher.as_ref()?;
        Some(Box::new(publisher.predicted()))
    }

    fn set_clock_shift(&mut self, shift_ns: i64) {
        self.clock_shift_ns = shift_ns;
        if let Some(publisher) = &mut self.publisher {
            publisher.set_clock_shift(shift_ns);
        }
    }

    fn end(&mut self, report: &RunReport) {
        let Some(publisher) = self.publisher.take() else { return };
        let is_in_order = matches!(report.ended_early, None | Some(RunError::Interrupted { .. }));
        let last = report.final_status.clone().filter(|_| is_in_order).map(|status| {
            let mut last = StatusReport::new(report.last_state_ns, status);
            last.queries = report.queries;
            last
        });
        publisher.close(last.as_ref());
    }
}
