//! Alarms of a run: what contradicts its sensors or its map, and what to do about it.

use serde::Serialize;

/// Alarms that are kept; further ones are only logged.
const MAX_KEPT: usize = 100;

/// Something that a person has to look at. The run goes on.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Alarm {
    /// Time since the first frame when it began, seconds.
    pub seconds: f64,
    /// When it ended; none where it lasted to the end.
    pub ended_s: Option<f64>,
    /// What it is, and what to do.
    pub reason: String,
}

/// The alarms of a run, each of a kind `K`.
#[derive(Debug)]
pub(crate) struct Alarms<K> {
    kept: Vec<Alarm>,
    /// Kinds that are on, with their index in `kept`.
    on: Vec<(K, usize)>,
}

impl<K> Default for Alarms<K> {
    fn default() -> Self {
        Self { kept: Vec::new(), on: Vec::new() }
    }
}

impl<K: PartialEq> Alarms<K> {
    /// Takes in all alarms that are on at a time. Those that begin or end are logged; one that goes on is not, also where
    /// its numbers change.
    pub(crate) fn update(&mut self, seconds: f64, now: Vec<(K, String)>) {
        let kept = &mut self.kept;
        self.on.retain(|(kind, index)| {
            let goes_on = now.iter().any(|(other, _)| other == kind);
            if let Some(alarm) = kept.get_mut(*index).filter(|_| !goes_on) {
                tracing::info!(reason = alarm.reason, "an alarm has ended");
                alarm.ended_s = Some(seconds);
            }
            goes_on
        });
        for (kind, reason) in now {
            if self.on.iter().any(|(other, _)| *other == kind) {
                continue;
            }
            tracing::error!("ALARM: {reason}");
            self.on.push((kind, self.kept.len()));
            if self.kept.len() < MAX_KEPT {
                self.kept.push(Alarm { seconds, ended_s: None, reason });
            }
        }
    }

    /// All alarms of the run so far.
    pub(crate) fn kept(&self) -> &[Alarm] {
        &self.kept
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn on(kinds: &[u8]) -> Vec<(u8, String)> {
        kinds.iter().map(|kind| (*kind, format!("kind {kind}"))).collect()
    }

    #[test]
    fn an_alarm_is_kept_once_while_it_lasts_with_its_begin_and_its_end() {
        let mut alarms = Alarms::default();
        for (seconds, kinds) in [(1.0, &[1][..]), (2.0, &[1, 2]), (3.0, &[2]), (4.0, &[2]), (5.0, &[1])] {
            alarms.update(seconds, on(kinds));
        }
        let times: Vec<_> = alarms.kept().iter().map(|alarm| (alarm.seconds, alarm.ended_s)).collect();
        assert_eq!(times, [(1.0, Some(3.0)), (2.0, Some(5.0)), (5.0, None)]);
    }

    #[test]
    fn alarms_that_come_and_go_do_not_fill_the_memory() {
        let mut alarms = Alarms::default();
        for second in 0..1000 {
            alarms.update(f64::from(second), on(&[1][..second as usize % 2]));
        }
        assert_eq!(alarms.kept().len(), MAX_KEPT);
    }
}
