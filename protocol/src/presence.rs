//! Whether a robot is there: by its liveliness token, and by what it publishes.

use crate::published::Published;
use crate::robot::RobotState;
use std::time::{Duration, Instant};

/// A robot that publishes nothing for so long is not there: it publishes its status at least once a second.
pub const SILENCE: Duration = Duration::from_secs(5);

/// What is known of a robot's presence. Times are those at which things came, since the clocks of sensors are their own.
///
/// ```
/// use std::time::{Duration, Instant};
///
/// let now = Instant::now();
/// let robot = protocol::Presence::new(now);
/// assert!(robot.is_online(now) && !robot.is_online(now + Duration::from_secs(6)));
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Presence {
    /// Last sign of life: a message or the begin of a liveliness token.
    heard: Instant,
    /// Since when its liveliness token is gone.
    gone: Option<Instant>,
    /// When it stated that it shuts down.
    off: Option<Instant>,
}

impl Presence {
    /// A robot that was heard of for the first time.
    pub fn new(now: Instant) -> Self {
        Self { heard: now, gone: None, off: None }
    }

    /// It published something. What was on its way when the token went, or when it shut down, is no sign of life; who goes on publishing is
    /// there. The status of a robot that shuts down may come before or after its token went.
    pub fn note_published(&mut self, published: &Published, now: Instant) {
        if matches!(published, Published::Status(status) if status.state == RobotState::Off) {
            (self.heard, self.off) = (now, Some(now));
        } else {
            self.note_message(now);
        }
    }

    fn note_message(&mut self, now: Instant) {
        let ended = self.gone.max(self.off);
        if ended.is_none_or(|ended| now.duration_since(ended) > SILENCE) {
            *self = Self::new(now);
        }
    }

    /// Its [liveliness token](crate::keys::robot) came or went.
    pub fn note_token(&mut self, is_there: bool, now: Instant) {
        if is_there {
            *self = Self::new(now);
        } else {
            self.gone = Some(now);
        }
    }

    /// Whether its session ended: its liveliness token went, or it shut down.
    pub fn has_ended(&self) -> bool {
        self.gone.is_some() || self.is_off()
    }

    /// Whether it shut down in order, and said so ([`RobotState::Off`]). Where its session [ended](Self::has_ended) without that, it was killed or lost
    /// its connection.
    pub fn is_off(&self) -> bool {
        self.off.is_some()
    }

    /// Seconds since the last sign of life.
    pub fn heard_age_s(&self, now: Instant) -> f64 {
        now.duration_since(self.heard).as_secs_f64()
    }

    /// Whether it is there.
    pub fn is_online(&self, now: Instant) -> bool {
        !self.has_ended() && now.duration_since(self.heard) <= SILENCE
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::RobotStatus;

    #[test]
    fn a_robot_is_gone_with_its_token_or_when_it_is_silent() {
        let start = Instant::now();
        let at = |seconds: f64| start + Duration::from_secs_f64(seconds);
        let mut robot = Presence::new(start);
        robot.note_token(true, at(0.0));
        for second in 1..20 {
            robot.note_message(at(f64::from(second)));
        }
        assert!(robot.is_online(at(23.9)) && !robot.is_online(at(24.1)), "silent");
        robot.note_message(at(30.0));
        assert!(robot.is_online(at(30.0)));
        robot.note_token(false, at(31.0));
        robot.note_message(at(31.2));
        assert!(!robot.is_online(at(31.2)) && robot.has_ended(), "a late message");
        assert!((robot.heard_age_s(at(31.2)) - 1.2).abs() < 1e-9);
        robot.note_message(at(37.0));
        assert!(robot.is_online(at(37.0)) && !robot.has_ended(), "it goes on publishing");
        robot.note_token(false, at(38.0));
        robot.note_token(true, at(38.5));
        assert!(robot.is_online(at(38.5)), "it was started again");
    }

    fn off() -> Published {
        Published::Status(RobotStatus {
            stamp_ns: 5,
            state: RobotState::Off,
            reason: "it was shut down".to_owned(),
            map: None,
            last_map_update_ns: None,
            keyframes_held: 0,
            queries_sent: 0,
            queries_answered: 0,
        })
    }

    #[test]
    fn a_robot_that_said_so_is_off_in_whatever_order_its_last_messages_come() {
        let start = Instant::now();
        let at = |seconds: f64| start + Duration::from_secs_f64(seconds);
        for is_token_first in [true, false] {
            let mut robot = Presence::new(start);
            for k in 0..2 {
                if is_token_first == (k == 0) {
                    robot.note_token(false, at(1.0));
                } else {
                    robot.note_published(&off(), at(1.0));
                }
            }
            robot.note_message(at(1.1));
            assert!(robot.is_off() && robot.has_ended() && !robot.is_online(at(1.1)), "{is_token_first}");
            assert!(robot.is_off() && !robot.is_online(at(3600.0)), "for as long as nothing comes");
            robot.note_token(true, at(3600.0));
            assert!(!robot.is_off() && robot.is_online(at(3600.0)), "it was started again");
        }
        let mut killed = Presence::new(start);
        killed.note_token(false, at(1.0));
        assert!(killed.has_ended() && !killed.is_off());
        // Of a robot without a token.
        let mut robot = Presence::new(start);
        robot.note_published(&off(), at(1.0));
        assert!(robot.has_ended() && !robot.is_online(at(1.0)));
        robot.note_message(at(7.0));
        assert!(robot.is_online(at(7.0)) && !robot.is_off(), "it goes on publishing");
    }
}
