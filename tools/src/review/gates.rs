//! What a candidate is refused for.

use super::ReviewedDrive;
use super::figures::{DriveFigures, ErrorFigures, WINDOW_S};
use super::structure::Structure;
use serde::Serialize;

/// Errors to the truth that differ by less (m) are equal.
const EQUAL_ERROR_M: f64 = 0.01;

/// How much worse than the live release a candidate may be.
#[derive(Clone, Debug, PartialEq, Serialize, clap::Args)]
pub struct Gates {
    /// Of the answers that update the robot in the live release, this part must do so in the candidate; one may always be missing
    #[arg(long, value_name = "PART", default_value_t = Self::DEFAULT.min_accepted,
        value_parser = not_negative, help_heading = GATES)]
    pub min_accepted: f64,
    /// Largest growth of the error to the truth, as a factor: one map's varies by a fifth from drive to drive
    #[arg(long, value_name = "FACTOR", default_value_t = Self::DEFAULT.max_error_growth,
        value_parser = not_negative, help_heading = GATES)]
    pub max_error_growth: f64,
    /// Largest NEES of the poses, and largest mean squared innovation per degree of freedom, where the live release has less: 1 is
    /// consistent
    #[arg(long, value_name = "NEES", default_value_t = Self::DEFAULT.max_nees,
        value_parser = not_negative, help_heading = GATES)]
    pub max_nees: f64,
    /// Largest distance between the poses in both, for a drive without truth; with truth, largest growth of the error within 5 s, m
    #[arg(long, value_name = "M", default_value_t = Self::DEFAULT.max_disagreement_m,
        value_parser = not_negative, help_heading = GATES)]
    pub max_disagreement_m: f64,
    /// So many more images than in the live release may be localized in a wrong place
    #[arg(long, value_name = "N", default_value_t = Self::DEFAULT.max_wrong, help_heading = GATES)]
    pub max_wrong: usize,
    /// The first pose from cold may come so much later (95 % of the images), s
    #[arg(long, value_name = "SECONDS", default_value_t = Self::DEFAULT.max_map_initialization_s,
        value_parser = not_negative, help_heading = GATES)]
    pub max_map_initialization_s: f64,
    /// This part more of the images, and of the map's views, may look like several places
    #[arg(long, value_name = "PART", default_value_t = Self::DEFAULT.max_ambiguous,
        value_parser = not_negative, help_heading = GATES)]
    pub max_ambiguous: f64,
    /// This part of the keyframes may move by more than the covariance that the live release states explains
    #[arg(long, value_name = "PART", default_value_t = Self::DEFAULT.max_unexplained,
        value_parser = not_negative, help_heading = GATES)]
    pub max_unexplained: f64,
    /// So many places, cubes of 10 m, may have moved: most of their keyframes by more than the covariance of the live release explains
    #[arg(long, value_name = "N", default_value_t = Self::DEFAULT.max_moved_places, help_heading = GATES)]
    pub max_moved_places: usize,
    /// This part of the places of the live release, cubes of 10 m by the direction of view, and ten at most, may have no keyframe near
    /// that looks the same way
    #[arg(long, value_name = "PART", default_value_t = Self::DEFAULT.max_emptied,
        value_parser = not_negative, help_heading = GATES)]
    pub max_emptied: f64,
    /// Of the poses of a drive without truth, this part must be within the live release: what it does not know cannot be judged
    #[arg(long, value_name = "PART", default_value_t = Self::DEFAULT.min_judged,
        value_parser = not_negative, help_heading = GATES)]
    pub min_judged: f64,
}

/// Places that may be emptied in a map of any size, by default.
const MOST_EMPTIED: f64 = 10.0;

const GATES: &str = "Gates";

/// Parses a number that can be a bound: with others a gate would refuse everything, or nothing.
fn not_negative(text: &str) -> Result<f64, String> {
    let number = text.trim().parse().ok().filter(|number: &f64| number.is_finite() && *number >= 0.0);
    number.ok_or_else(|| "give a finite number that is not negative".to_owned())
}

impl Gates {
    const DEFAULT: Self = Self {
        min_accepted: 0.95,
        max_error_growth: 1.25,
        max_nees: 2.0,
        max_disagreement_m: 0.1,
        max_wrong: 0,
        max_map_initialization_s: 2.0,
        max_ambiguous: 0.05,
        max_unexplained: 0.01,
        max_moved_places: 0,
        max_emptied: 0.05,
        min_judged: 0.5,
    };
}

impl Default for Gates {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// Why a candidate should not be promoted.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Refusal {
    /// The switch of the gate.
    pub gate: &'static str,
    /// The drive; `None` for what concerns the map.
    pub drive: Option<String>,
    /// What was found and what is allowed; a sentence.
    pub reason: String,
}

impl Gates {
    /// What the maps themselves are refused for.
    pub(super) fn structure(&self, structure: &Structure) -> Vec<Refusal> {
        let mut refusals = Refusals { drive: None, all: Vec::new() };
        let Structure { common_keyframes, unexplained, moved_m, places, emptied_m, live, candidate, .. } =
            structure;
        let allowed = |part: f64, of: usize| part * of as f64;
        if unexplained.len() as f64 > allowed(self.max_unexplained, *common_keyframes) {
            let largest = structure.difference.keyframes.motion.map_or(0.0, |motion| motion.largest_m);
            refusals.add("--max-unexplained", format!(
                "{} of {common_keyframes} keyframes moved by more than the covariance of the live map explains, by {largest:.2} m at most",
                unexplained.len()
            ));
        }
        if moved_m.len() > self.max_moved_places {
            let [x, y, z] = moved_m.first().copied().unwrap_or_default();
            refusals.add("--max-moved-places", format!(
                "most keyframes of {} places moved by more than the covariance of the live map explains, one at ({x:.1}, {y:.1}, {z:.1}) m",
                moved_m.len()
            ));
        }
        // A larger part is meant for maps of any size.
        let most = if self.max_emptied > Self::DEFAULT.max_emptied { f64::INFINITY } else { MOST_EMPTIED };
        if emptied_m.len() as f64 > allowed(self.max_emptied, *places).min(most) {
            let [x, y, z] = emptied_m.first().copied().unwrap_or_default();
            refusals.add("--max-emptied", format!(
                "{} of {places} places of the live map have no keyframe any more that looks the same way, one at ({x:.1}, {y:.1}, {z:.1}) m",
                emptied_m.len()
            ));
        }
        if candidate.aliased > live.aliased + self.max_ambiguous {
            refusals.add(
                "--max-ambiguous",
                format!(
                    "{:.0} % of the views could be of another place, {:.0} % in the live map",
                    100.0 * candidate.aliased,
                    100.0 * live.aliased
                ),
            );
        }
        refusals.all
    }

    /// What a drive is refused for.
    pub(super) fn drive(&self, drive: &ReviewedDrive) -> Vec<Refusal> {
        let ReviewedDrive { recording, live, candidate, .. } = drive;
        let mut refusals = Refusals { drive: Some(recording.clone()), all: Vec::new() };
        if live.accepted == 0 && candidate.accepted == 0 {
            refusals.add(
                "--drive",
                "no answer of either map updated the robot: the drive says nothing about the candidate"
                    .to_owned(),
            );
        }
        self.answers(live, candidate, &mut refusals);
        self.judged(candidate, &mut refusals);
        match (&live.errors, &candidate.errors) {
            (Some(live), Some(candidate)) if candidate.is_to_truth => {
                self.errors(live, candidate, &mut refusals);
            }
            (_, Some(errors)) if errors.largest_m > self.max_disagreement_m => {
                refusals.add("--max-disagreement-m", format!(
                    "poses differ from those in the live map by up to {:.3} m (RMS {:.3} m), at most {} m are allowed",
                    errors.largest_m, errors.rmse_m, self.max_disagreement_m
                ));
            }
            _ => {}
        }
        self.cold(live, candidate, &mut refusals);
        refusals.all
    }

    /// Without truth, poses beyond what the live map knows cannot be compared with any.
    fn judged(&self, candidate: &DriveFigures, refusals: &mut Refusals) {
        if candidate.errors.as_ref().is_some_and(|errors| errors.is_to_truth) {
            return;
        }
        let judged = candidate.errors.as_ref().map_or(0, |errors| errors.poses);
        if (judged as f64) < self.min_judged * candidate.poses as f64 {
            refusals.add("--min-judged", format!(
                "{judged} of {} poses can be compared with poses in the live map: record the truth, drive where the live map is known as well, \
                 or look at the report and give `--min-judged 0`",
                candidate.poses
            ));
        }
    }

    fn answers(&self, live: &DriveFigures, candidate: &DriveFigures, refusals: &mut Refusals) {
        let [accepted, of_live] = [candidate, live].map(|figures| figures.accepted);
        if ((accepted + 1) as f64) < self.min_accepted * of_live as f64 {
            refusals.add(
                "--min-accepted",
                format!(
                    "{accepted} of {} answers updated the robot, {of_live} of {} in the live map",
                    candidate.queries, live.queries
                ),
            );
        }
        let [innovation, of_live] = [candidate, live].map(|figures| figures.innovation.unwrap_or(0.0));
        if innovation > self.max_nees && innovation > self.max_error_growth * of_live {
            refusals.add("--max-nees", format!(
                "answers contradict the robot's state: the mean squared innovation is {innovation:.1} a degree of freedom, {of_live:.1} in the live map"
            ));
        }
    }

    fn errors(&self, live: &ErrorFigures, candidate: &ErrorFigures, refusals: &mut Refusals) {
        let limit = (self.max_error_growth * live.rmse_m).max(live.rmse_m + EQUAL_ERROR_M);
        if candidate.rmse_m > limit {
            refusals.add("--max-error-growth", format!(
                "poses are off the truth by {:.3} m RMS and {:.3} m at most, {:.3} m and {:.3} m in the live map",
                candidate.rmse_m, candidate.largest_m, live.rmse_m, live.largest_m
            ));
        }
        let worse = candidate.windows.iter().filter_map(|(window, rmse_m)| {
            let of_live = *live.windows.get(window)?;
            let limit_m = (self.max_error_growth * of_live).max(of_live + self.max_disagreement_m);
            Some((*window, *rmse_m, of_live, rmse_m - limit_m))
        });
        let worst = worse.filter(|(.., beyond)| *beyond > 0.0).max_by(|a, b| a.3.total_cmp(&b.3));
        if let Some((window, rmse_m, of_live, _)) = worst {
            refusals.add("--max-disagreement-m", format!(
                "from {:.0} s of the drive on, poses are off the truth by {rmse_m:.3} m RMS within {WINDOW_S:.0} s, {of_live:.3} m in the live map",
                f64::from(window) * WINDOW_S
            ));
        }
        let [nees, of_live] = [candidate, live].map(|errors| errors.nees.unwrap_or(0.0));
        if nees > self.max_nees && nees > self.max_error_growth * of_live {
            refusals.add("--max-nees", format!(
                "poses are off the truth by more than they state: NEES {nees:.1}, {of_live:.1} in the live map"
            ));
        }
    }

    fn cold(&self, live: &DriveFigures, candidate: &DriveFigures, refusals: &mut Refusals) {
        let (live, candidate) = (&live.cold, &candidate.cold);
        if candidate.wrong > live.wrong + self.max_wrong {
            refusals.add(
                "--max-wrong",
                format!(
                    "{} of {} images are localized in a wrong place, {} in the live map",
                    candidate.wrong, candidate.images, live.wrong
                ),
            );
        }
        if candidate.map_initialization_p95_s > live.map_initialization_p95_s + self.max_map_initialization_s
        {
            refusals.add("--max-map-initialization-s", format!(
                "a robot that starts is localized within {:.1} s (95 %), {:.1} s in the live map; {} of {} images are localized, {} in the live map",
                candidate.map_initialization_p95_s, live.map_initialization_p95_s, candidate.localized, candidate.images, live.localized
            ));
        }
        let [ambiguous, of_live] =
            [candidate, live].map(|cold| cold.ambiguous as f64 / cold.images.max(1) as f64);
        if ambiguous > of_live + self.max_ambiguous && candidate.ambiguous > live.ambiguous + 1 {
            refusals.add(
                "--max-ambiguous",
                format!(
                    "{} of {} images could be of several places, {} in the live map",
                    candidate.ambiguous, candidate.images, live.ambiguous
                ),
            );
        }
    }
}

/// Refusals of one drive, or of the map.
struct Refusals {
    drive: Option<String>,
    all: Vec<Refusal>,
}

impl Refusals {
    fn add(&mut self, gate: &'static str, reason: String) {
        self.all.push(Refusal { gate, drive: self.drive.clone(), reason });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser as _;

    #[derive(clap::Parser)]
    struct Line {
        #[command(flatten)]
        gates: Gates,
    }

    #[test]
    fn a_gate_is_a_finite_number_that_is_not_negative() {
        let gates = |switch: &str| Line::try_parse_from(["review", switch]).map(|line| line.gates);
        let same = Gates { max_nees: 3.5, ..Gates::default() };
        assert!(gates("--max-nees=3.5").is_ok_and(|gates| gates == same));
        for gate in [
            "min-accepted",
            "max-error-growth",
            "max-nees",
            "max-disagreement-m",
            "max-wrong",
            "max-map-initialization-s",
            "max-ambiguous",
            "max-unexplained",
            "max-moved-places",
            "max-emptied",
            "min-judged",
        ] {
            assert!(gates(&format!("--{gate}=0")).is_ok(), "{gate}");
            for wrong in ["nan", "inf", "-1", "much"] {
                assert!(gates(&format!("--{gate}={wrong}")).is_err(), "{gate} {wrong}");
            }
        }
    }
}
