//! Drives: sessions of one robot that follow each other without a pause.
//!
//! A robot begins a new session every ten minutes. The pieces of a drive are of one light and much the same viewpoints: what one of them
//! misses of a landmark that is there, the others miss, too.

use std::ops::RangeInclusive;

use map::sessions::Session;

/// Sessions with more time between them are of two drives (ns): a robot begins the next piece with the next image.
const PAUSE_NS: i64 = 2_000_000_000;

/// The time of the drive (ns) that a session is a piece of: its own, and that of the sessions of its robot that follow or precede it.
///
/// # Arguments
/// * `sessions`: the ledger, which may have the session.
pub(crate) fn drive_of(session: &Session, sessions: &[Session]) -> RangeInclusive<i64> {
    let (mut begin_ns, mut end_ns) = (session.begin_ns, session.end_ns);
    let is_of_robot = |other: &&Session| other.robot.is_some() && other.robot == session.robot;
    let mut others: Vec<&Session> = sessions.iter().filter(is_of_robot).collect();
    loop {
        let before = others.len();
        others.retain(|other| {
            let touches = other.begin_ns <= end_ns.saturating_add(PAUSE_NS)
                && other.end_ns >= begin_ns.saturating_sub(PAUSE_NS);
            if touches {
                (begin_ns, end_ns) = (begin_ns.min(other.begin_ns), end_ns.max(other.end_ns));
            }
            !touches
        });
        if others.len() == before {
            return begin_ns..=end_ns;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use map::sessions::{ReadingSamples, Recorded, SessionId};

    const SECOND_NS: i64 = 1_000_000_000;

    fn session(robot: Option<&str>, seconds: [i64; 2]) -> Session {
        let recorded = Recorded {
            id: SessionId::from_bytes([0; 16]),
            begin_ns: seconds[0] * SECOND_NS,
            end_ns: seconds[1] * SECOND_NS,
            images: 1,
            readings: 1,
            samples: ReadingSamples::default(),
        };
        Session::new(recorded, "drive").by_robot(robot)
    }

    #[test]
    fn pieces_of_one_robot_are_one_drive_in_any_order() {
        let cart = |seconds| session(Some("cart"), seconds);
        let ledger = [cart([1200, 1800]), cart([0, 599]), cart([2400, 3000]), cart([600, 1199])];
        for piece in [0, 1, 3] {
            assert_eq!(drive_of(&ledger[piece], &ledger), 0..=1800 * SECOND_NS);
        }
        assert_eq!(drive_of(&ledger[2], &ledger), 2400 * SECOND_NS..=3000 * SECOND_NS);
    }

    #[test]
    fn other_robots_and_unknown_ones_drive_by_themselves() {
        let ledger = [session(Some("cart"), [0, 599]), session(None, [0, 599]), session(None, [600, 900])];
        let other = session(Some("lift"), [600, 900]);
        assert_eq!(drive_of(&other, &ledger), 600 * SECOND_NS..=900 * SECOND_NS);
        assert_eq!(drive_of(&ledger[2], &ledger), 600 * SECOND_NS..=900 * SECOND_NS);
    }
}
