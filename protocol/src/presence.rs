//! Whether a robot is there: by its liveliness token, and by what it publishes.

use std::time::{Duration, Instant};

/// A robot that publishes nothing for so long is not there: it publishes its status at least once a second.
const SILENCE: Duration = Duration::from_secs(5);

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
}

impl Presence {
    /// A robot that was heard of for the first time.
    pub fn new(now: Instant) -> Self {
        Self { heard: now, gone: None }
    }

    /// It published something. What was on its way when the token went is no sign of life; who goes on publishing is there.
    pub fn note_message(&mut self, now: Instant) {
        if self.gone.is_none_or(|gone| now.duration_since(gone) > SILENCE) {
            (self.heard, self.gone) = (now, None);
        }
    }

    /// Its [liveliness token](crate::keys::robot) came or went.
    pub fn note_token(&mut self, is_there: bool, now: Instant) {
        if is_there {
            (self.heard, self.gone) = (now, None);
        } else {
            self.gone = Some(now);
        }
    }

    /// Whether its liveliness token went: its session ended.
    pub fn has_ended(&self) -> bool {
        self.gone.is_some()
    }

    /// Seconds since the last sign of life.
    pub fn heard_age_s(&self, now: Instant) -> f64 {
        now.duration_since(self.heard).as_secs_f64()
    }

    /// Whether it is there.
    pub fn is_online(&self, now: Instant) -> bool {
        self.gone.is_none() && now.duration_since(self.heard) <= SILENCE
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
}
