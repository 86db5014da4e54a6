//! Warnings that would come with every image.

use std::time::{Duration, Instant};

/// Time between two lines of one warning.
const PERIOD: Duration = Duration::from_secs(10);

/// Decides which of many equal warnings are logged: the first, and then one in ten seconds.
///
/// ```
/// let mut warning = odometry::RepeatedWarning::default();
/// assert_eq!(warning.note(), Some(0));
/// assert_eq!(warning.note(), None);
/// ```
#[derive(Debug, Default)]
pub struct RepeatedWarning {
    logged: Option<Instant>,
    since: u64,
}

impl RepeatedWarning {
    /// Counts one.
    ///
    /// # Returns
    /// Where it is to be logged: how many were not since the last one that was.
    pub fn note(&mut self) -> Option<u64> {
        self.note_at(Instant::now())
    }

    fn note_at(&mut self, now: Instant) -> Option<u64> {
        if self.logged.is_some_and(|logged| now.duration_since(logged) < PERIOD) {
            self.since += 1;
            return None;
        }
        self.logged = Some(now);
        Some(std::mem::take(&mut self.since))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_line_in_ten_seconds_says_how_many_there_were() {
        let start = Instant::now();
        let mut warning = RepeatedWarning::default();
        let lines: Vec<u64> = (0..250)
            .filter_map(|image| warning.note_at(start + image * Duration::from_millis(100)))
            .collect();
        assert_eq!(lines, [0, 99, 99]);
    }
}
