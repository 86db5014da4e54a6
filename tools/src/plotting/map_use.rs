//! Where a run had a map, and which answers it used: bands and dots behind what is drawn over time.

use super::canvas::{BAD, GOOD, LegendEntry, Mark, SHADE, entry};
use super::panel::Series;
use super::run_files::RunFiles;
use super::series::quantile;
use onboard::Event;
use std::ops::Range;

/// Queries come at intervals: no answer for so many of them is no map.
const MISSED_QUERIES: f64 = 3.0;
/// Shorter stretches are not seen, seconds.
const SHORTEST_S: f64 = 1.0;
/// Height of the dots above the lower end of the axis, as a fraction of its length.
const DOTS_AT: f64 = 0.035;

/// When the map answered, seconds of the run.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct MapUse {
    /// Stretches without an answer that was used.
    without_map: Vec<Range<f64>>,
    used: Vec<f64>,
    /// Answers with matches that were not used.
    refused: Vec<f64>,
}

impl MapUse {
    /// Of a run; empty where it asked for nothing.
    pub(crate) fn of(run: &RunFiles) -> Self {
        let events = run.events.as_deref().unwrap_or_default();
        let at = |wanted: &dyn Fn(&Event) -> bool| -> Vec<f64> {
            events.iter().filter(|event| wanted(event)).map(|event| run.seconds(event.stamp_ns)).collect()
        };
        let used = at(&|event| event.accepted);
        let refused = at(&|event| !event.accepted && event.matches > 0);
        let without_map = stretches_without(&at(&|_| true), &used, run.duration());
        Self { without_map, used, refused }
    }

    /// Entries of the legend, of what there is.
    pub(crate) fn legend(&self) -> Vec<LegendEntry> {
        [
            (self.without_map.is_empty(), Mark::Patch, SHADE, "no answer used"),
            (self.used.is_empty(), Mark::Dot, GOOD, "answer used"),
            (self.refused.is_empty(), Mark::Dot, BAD, "answer refused"),
        ]
        .into_iter()
        .filter(|(is_empty, ..)| !is_empty)
        .map(|(_, mark, colour, text)| entry(mark, colour, text))
        .collect()
    }

    /// Bands behind everything else.
    pub(crate) fn bands(&self) -> impl Iterator<Item = Series> {
        Series::columns(&self.without_map, SHADE)
    }

    /// Dots at the lower end of an axis.
    pub(crate) fn marks(&self, y: &Range<f64>) -> [Series; 2] {
        let height = y.start + DOTS_AT * (y.end - y.start);
        let dots = |times: &[f64], colour, radius| {
            Series::dots(times.iter().map(|time| (*time, height)).collect(), colour, radius)
        };
        [dots(&self.used, GOOD, 2), dots(&self.refused, BAD, 3)]
    }
}

/// The stretches of a run in which no answer was used for longer than some intervals between queries.
fn stretches_without(queries: &[f64], used: &[f64], duration: f64) -> Vec<Range<f64>> {
    let Some(interval) = quantile(queries.windows(2).map(|pair| pair[1] - pair[0]), 0.5) else {
        return Vec::new();
    };
    let longest = (MISSED_QUERIES * interval).max(SHORTEST_S);
    let ends: Vec<f64> = [0.0].into_iter().chain(used.iter().copied()).chain([duration]).collect();
    let gaps = ends.windows(2).map(|pair| pair[0]..pair[1]);
    gaps.filter(|gap| gap.end - gap.start > longest).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stretches_without_an_answer_are_found_at_the_ends_too() {
        let queries: Vec<f64> = (0..40).map(|index| 0.5 * f64::from(index)).collect();
        let used: Vec<f64> = queries
            .iter()
            .copied()
            .filter(|at| (4.0..6.8).contains(at) || (7.2..10.0).contains(at))
            .collect();
        assert_eq!(stretches_without(&queries, &used, 20.0), [0.0..4.0, 9.5..20.0]);
        assert_eq!(stretches_without(&queries, &[], 20.0), [0.0..20.0]);
        assert!(stretches_without(&queries, &queries, 20.0).is_empty());
        assert!(stretches_without(&[], &[], 20.0).is_empty(), "a run that asked for nothing");
    }
}
