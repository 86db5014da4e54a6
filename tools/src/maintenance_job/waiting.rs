//! Sessions that a map does not have yet.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::Result;
use hand_in::Session;
use map::MapContents;
use map::sessions::{SessionId, utc_time};
use mapping::BuildOptions;
use protocol::MapIdentity;

use crate::session_files;

/// A session may end so long from now: clocks differ. It may end so long from when it began by the clock of its robot.
const MAX_AHEAD_DAYS: f64 = 1.0;
/// Seconds of a day.
const DAY_S: f64 = 86_400.0;

/// A session that the map does not have yet.
pub(super) struct Waiting {
    pub(super) file: PathBuf,
    pub(super) id: SessionId,
    pub(super) robot: String,
    pub(super) begin_ns: i64,
    pub(super) build: BuildOptions,
    /// The maps that its robot asked.
    asked: BTreeSet<MapIdentity>,
    /// Why its times are in doubt.
    pub(super) doubt: Option<String>,
    /// Why it cannot be of a time that has been: everything else in the map would look old.
    pub(super) ahead: Option<String>,
}

impl Waiting {
    /// Whether its robot asked maps, and this one was none of them.
    pub(super) fn is_of_other(&self, map: &MapContents) -> bool {
        map.info.identity.is_some_and(|identity| !self.asked.is_empty() && !self.asked.contains(&identity))
    }

    /// Reads what is known of a session before it is worked on.
    ///
    /// # Errors
    /// It is no session, or damaged, or nothing was recorded.
    pub(super) fn open(file: &Path) -> Result<Waiting> {
        let session = Session::open(file)?;
        let so_far = session.recorded.as_ref();
        let Some(recorded) = so_far.map(session_files::recorded) else {
            anyhow::bail!("it was cut off before anything was recorded");
        };
        let ahead = ahead(recorded.end_ns, now_unix_s(), &session.header.robot);
        let doubt = clock_doubt(session.header.started_unix_s, recorded.end_ns, &session.header.robot);
        let asked = session.answers.iter().map(|answer| answer.map_identity).collect();
        let robot = session.header.robot;
        let (id, begin_ns) = (recorded.id, recorded.begin_ns);
        let mut build = BuildOptions::default();
        build.robot = Some(robot.clone());
        build.recorded = Some(recorded);
        Ok(Waiting { file: file.to_owned(), id, robot, begin_ns, build, asked, doubt, ahead })
    }
}

/// Seconds since 1970.
pub(super) fn now_unix_s() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |elapsed| elapsed.as_secs())
}

/// Why a session is not of a time that has been: it ends days from now.
///
/// # Arguments
/// * `end_ns`: time of its last image, nanoseconds.
/// * `now_s`: seconds since 1970.
fn ahead(end_ns: i64, now_s: u64, robot: &str) -> Option<String> {
    let days = (end_ns as f64 * 1e-9 - now_s as f64) / DAY_S;
    (days >= MAX_AHEAD_DAYS).then(|| {
        format!(
            "its last image is of {days:.0} days after {}: the clock of robot {robot} was wrong then, so that it is never used: delete its file",
            utc_time(now_s)
        )
    })
}

/// Why the times of a session are in doubt: its images are days from when it began by the clock of its robot.
///
/// # Arguments
/// * `started_unix_s`: when it began, seconds since 1970; 0 where that is not known.
/// * `end_ns`: time of its last image, nanoseconds.
fn clock_doubt(started_unix_s: u64, end_ns: i64, robot: &str) -> Option<String> {
    let days = (end_ns as f64 * 1e-9 - started_unix_s as f64) / DAY_S;
    (started_unix_s > 0 && days.abs() > MAX_AHEAD_DAYS).then(|| {
        let way = if days < 0.0 { "before" } else { "after" };
        format!(
            "its last image is of {:.0} days {way} it began by the clock of robot {robot}: the clock of its cameras was wrong, or a \
             recording was played; the map takes the times of the images for when things were seen",
            days.abs()
        )
    })
}

/// The identity of a session that a map has already. An inbox keeps what was taken from it: it is not decoded again each night.
pub(super) fn known_session(map: &MapContents, file: &Path) -> Option<SessionId> {
    // An error is that of the session as a whole, too.
    let identity = Session::identify(file).ok()??;
    let id = SessionId::from_bytes(identity.id);
    map.info.sessions.iter().any(|known| known.id == id).then_some(id)
}

#[cfg(test)]
mod tests {
    use super::{ahead, clock_doubt};

    #[test]
    fn times_of_images_that_are_days_from_the_clock_of_the_robot_are_in_doubt() {
        const NOW_S: u64 = 1_750_000_000;
        let end_ns = |s: i64| s * 1_000_000_000;
        let now = NOW_S as i64;
        for fine in [now, now + 80_000, now - 80_000] {
            assert_eq!(clock_doubt(NOW_S, end_ns(fine), "ada"), None);
        }
        let booted_in_1970 = clock_doubt(NOW_S, end_ns(600), "ada").unwrap();
        assert!(
            booted_in_1970.contains("20255 days before") && booted_in_1970.contains("ada"),
            "{booted_in_1970}"
        );
        let ahead = clock_doubt(NOW_S, end_ns(now + 200_000), "ada").unwrap();
        assert!(ahead.contains("2 days after"), "{ahead}");
        // Not known.
        assert_eq!(clock_doubt(0, end_ns(now), "ada"), None);
    }

    #[test]
    fn a_session_that_ends_days_from_now_is_of_no_time_that_has_been() {
        let end_ns = 1_750_000_000_000_000_000;
        assert_eq!(ahead(end_ns, 1_750_000_000 - 80_000, "ada"), None);
        let reason = ahead(end_ns, 1_750_000_000 - 30 * 86_400, "ada").unwrap();
        assert!(reason.contains("30 days after 2025-05-16") && reason.contains("ada"), "{reason}");
    }
}
