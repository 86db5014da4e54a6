//! Drives: sessions of one robot that follow each other without a pause.
//!
//! A robot begins a new session every ten minutes. The pieces of a drive are of one light and much the same viewpoints: what one of them
//! misses of a landmark that is there, the others miss, too.

use map::sessions::Session;

/// Sessions with more time between them are of two drives (ns): a robot begins the next piece with the next image.
const PAUSE_NS: i64 = 2_000_000_000;
/// Longer before a piece, what the robot saw does not count as seen by the same light (ns): some robots drive for weeks.
const SAME_LIGHT_NS: i64 = 12 * 3_600_000_000_000;

/// The drive that a session is a piece of.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Drive {
    /// When it began (ns), [`SAME_LIGHT_NS`] before the session at the earliest.
    begin_ns: i64,
    /// Whether another piece of that time was taken before.
    is_known: bool,
}

impl Drive {
    #[cfg(test)]
    pub(crate) fn new(begin_ns: i64, is_known: bool) -> Drive {
        Drive { begin_ns, is_known }
    }

    /// The drive of a session: the sessions of its robot that follow or precede it.
    ///
    /// # Arguments
    /// * `sessions`: the ledger, which may have the session.
    pub(crate) fn of(session: &Session, sessions: &[Session]) -> Drive {
        let (mut begin_ns, mut end_ns) = (session.begin_ns, session.end_ns);
        let is_another_piece = |other: &&Session| {
            other.robot.is_some() && other.robot == session.robot && other.id != session.id
        };
        let mut others: Vec<&Session> = sessions.iter().filter(is_another_piece).collect();
        let earliest_ns = session.begin_ns.saturating_sub(SAME_LIGHT_NS);
        let mut is_known = false;
        loop {
            let before = others.len();
            others.retain(|other| {
                let touches = other.begin_ns <= end_ns.saturating_add(PAUSE_NS)
                    && other.end_ns >= begin_ns.saturating_sub(PAUSE_NS);
                if touches {
                    (begin_ns, end_ns) = (begin_ns.min(other.begin_ns), end_ns.max(other.end_ns));
                    is_known |= other.end_ns >= earliest_ns;
                }
                !touches
            });
            if others.len() == before {
                return Drive { begin_ns: begin_ns.max(earliest_ns), is_known };
            }
        }
    }

    /// Whether a piece may have counted for a landmark already.
    ///
    /// Nobody notes which session counted last, only when it was. That of a drive which is handed in late may be newer than the drive: then
    /// an earlier piece may have counted, too.
    pub(crate) fn may_have_counted(&self, last_counted_ns: i64) -> bool {
        self.is_known && last_counted_ns >= self.begin_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use map::sessions::{ReadingSamples, Recorded, SessionId};

    const SECOND_NS: i64 = 1_000_000_000;

    const HOUR_NS: i64 = 3600 * SECOND_NS;

    fn session(robot: Option<&str>, seconds: [i64; 2]) -> Session {
        let recorded = Recorded {
            id: SessionId::from_bytes(i128::from(seconds[0]).to_le_bytes()),
            begin_ns: seconds[0] * SECOND_NS,
            end_ns: seconds[1] * SECOND_NS,
            images: 1,
            readings: 1,
            samples: ReadingSamples::default(),
        };
        Session::new(recorded, "drive").by_robot(robot)
    }

    fn cart(seconds: [i64; 2]) -> Session {
        session(Some("cart"), seconds)
    }

    #[test]
    fn pieces_of_one_robot_are_one_drive_in_any_order() {
        let ledger = [cart([1200, 1800]), cart([0, 599]), cart([2400, 3000]), cart([600, 1199])];
        for piece in [0, 1, 3] {
            let drive = Drive { begin_ns: 0, is_known: true };
            assert_eq!(Drive::of(&ledger[piece], &ledger), drive);
        }
        let alone = Drive { begin_ns: 2400 * SECOND_NS, is_known: false };
        assert_eq!(Drive::of(&ledger[2], &ledger), alone);
    }

    #[test]
    fn other_robots_and_unknown_ones_drive_by_themselves() {
        let ledger = [session(Some("cart"), [0, 599]), session(None, [1, 599]), session(None, [600, 900])];
        let alone = Drive { begin_ns: 600 * SECOND_NS, is_known: false };
        assert_eq!(Drive::of(&session(Some("lift"), [600, 900]), &ledger), alone);
        assert_eq!(Drive::of(&ledger[2], &ledger), alone);
    }

    #[test]
    fn a_piece_counts_where_none_of_its_drive_can_have_counted() {
        let late = cart([0, 600]);
        let newer_ns = 40 * HOUR_NS;
        assert!(!Drive::of(&late, std::slice::from_ref(&late)).may_have_counted(newer_ns));
        let next = Drive::of(&cart([601, 1200]), &[late]);
        assert!(next.may_have_counted(newer_ns) && next.may_have_counted(600 * SECOND_NS));
        assert!(!next.may_have_counted(-1));
    }

    #[test]
    fn a_robot_that_drives_for_weeks_counts_twice_a_day() {
        let ledger: Vec<Session> = (0..300).map(|piece| cart([piece * 600, piece * 600 + 599])).collect();
        let drive = Drive::of(&ledger[299], &ledger);
        let begin_ns = 299 * 600 * SECOND_NS;
        assert!(drive.may_have_counted(begin_ns - 11 * HOUR_NS));
        assert!(!drive.may_have_counted(begin_ns - 13 * HOUR_NS));
    }
}
