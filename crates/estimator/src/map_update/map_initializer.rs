//! Which hypothesis about `global_from_local` initializes it.
//!
//! A picture that repeats shows a wrong place, and its answers agree with each other and with odometry. So agreement alone does
//! not initialize: each hypothesis collects the log-odds of the different places that support it, see
//! [`place_evidence`](super::place_evidence), and wins when these exceed a likelihood ratio and those of every alternative by
//! the same ratio. A distinctive view wins with its first answer.
//!
//! An answer that hardly constrains the pose agrees with several hypotheses, and is evidence for each of them: it does not tell
//! them apart. What it lacks in agreement counts against it, by the likelihood of the displacement.

use crate::map_update::fixed_pose::FixedPose;
use crate::map_update::place_evidence::{PlaceEvidence, SeenPlace};

/// Likelihood ratio that initializes. Of pictures that repeat at most one in so many exceeds it, if the stated odds are exact: of 480
/// answers to single images in halls that repeat themselves, 112 of them wrong, all 284 above it were right, and the largest odds of a
/// wrong one were 6.7.
pub const REQUIRED_ODDS: f64 = 7.0;
/// What an operator says has these odds where it predicts the position to so many metres (standard deviation), and less, as the area grows, while
/// the robot drives on from there: in the aisles of a hall another place that looks alike is some metres away.
const EXPECTED_SIGMA_M: f64 = 1.5;
/// Hypotheses that are kept, those of the largest odds.
const MAX_HYPOTHESES: usize = 8;
/// Part of the standard deviation of a hypothesis below which that of an answer is of another order.
const MUCH_MORE_CERTAIN: f64 = 0.5;

/// A pose by the map, and what its answer shows.
#[derive(Clone, Copy, Debug)]
pub struct Fix {
    /// The pose.
    pub pose: FixedPose,
    /// What its answer shows.
    pub seen: SeenPlace,
}

/// A hypothesis: the most certain of the poses of the answers that agree with it, and the places of all of them.
#[derive(Clone, Debug)]
struct Hypothesis {
    pose: FixedPose,
    evidence: PlaceEvidence,
    /// Logarithm of how much less likely the answers from before a much more certain one are with its pose.
    displaced: f64,
}

impl Hypothesis {
    fn new(pose: FixedPose, evidence: PlaceEvidence) -> Self {
        Self { pose, evidence, displaced: 0.0 }
    }

    /// Adds an answer that agrees with it, and takes its pose where that is as certain.
    ///
    /// Two answers of one place are as far apart as three errors of a standard deviation each, in rotation and in position; what is
    /// beyond that makes them less likely.
    ///
    /// # Returns
    /// Whether it took the pose.
    fn add(&mut self, fix: &Fix) -> bool {
        let beyond = |apart: f64| 0.5 * (apart * apart - 3.0).max(0.0);
        let less_likely_by: f64 = fix.pose.apart(&self.pose).into_iter().map(beyond).sum();
        let sigma_position = self.pose.sigma_with_drift(&fix.pose);
        if fix.pose.sigma_position < MUCH_MORE_CERTAIN * sigma_position {
            // It is the others that are displaced, however often this one comes again.
            self.displaced = self.displaced.max(less_likely_by);
            self.evidence.add(fix.seen);
        } else {
            self.evidence.add(fix.seen.less_likely_by(less_likely_by));
        }
        let takes = fix.pose.sigma_position <= sigma_position;
        if takes {
            self.pose = fix.pose;
        }
        takes
    }
}

/// How far the evidence for a map initialization is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Waiting {
    /// Logarithm of the odds of the best hypothesis.
    pub log_odds: f64,
    /// That of the best alternative; zero without one.
    pub alternative: f64,
}

impl Waiting {
    /// Whether the best hypothesis wins.
    fn is_over(&self) -> bool {
        // A negative one is worse than no alternative at all.
        self.log_odds - self.alternative.max(0.0) >= REQUIRED_ODDS.ln()
    }
}

impl std::fmt::Display for Waiting {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let odds = self.log_odds.exp();
        write!(f, "waits for a more distinctive view: odds {odds:.2} of {REQUIRED_ODDS:.0}")?;
        if self.alternative > 0.0 {
            write!(f, ", those of another place are {:.2}", self.alternative.exp())?;
        }
        Ok(())
    }
}

/// What an answer leads to.
#[derive(Clone, Debug)]
pub enum Decision {
    /// Its hypothesis initializes, with this evidence.
    Initialize(PlaceEvidence),
    /// More evidence is needed.
    Wait(Waiting),
}

/// The hypotheses while `global_from_local` is not known, of one version of the map.
#[derive(Clone, Debug, Default)]
pub struct MapInitializer {
    map_version: Option<u64>,
    hypotheses: Vec<Hypothesis>,
    /// Where the robot is according to its operator.
    expected: Option<FixedPose>,
    dropped: usize,
}

impl MapInitializer {
    /// Adds an answer to the hypotheses that it agrees with, or as a new one.
    pub fn add(&mut self, map_version: u64, fix: Fix) -> Decision {
        if self.map_version != Some(map_version) {
            self.hypotheses.clear();
            self.map_version = Some(map_version);
        }
        let agrees = |hypothesis: &Hypothesis| fix.pose.agrees(&hypothesis.pose);
        let mut agreeing: Vec<usize> =
            (0..self.hypotheses.len()).filter(|&at| agrees(&self.hypotheses[at])).collect();
        if agreeing.is_empty() {
            agreeing.push(self.insert(fix.pose));
        }
        let took_pose: Vec<usize> =
            agreeing.iter().copied().filter(|&at| self.hypotheses[at].add(&fix)).collect();
        let best = |candidates: &[usize]| {
            let odds = |at: &usize| self.log_odds(&self.hypotheses[*at]);
            candidates.iter().copied().max_by(|a, b| odds(a).total_cmp(&odds(b))).unwrap_or(0)
        };
        let own =
            if took_pose.is_empty() { best(&agreeing) } else { self.join(best(&took_pose), &took_pose) };
        let waiting = self.against(own);
        if waiting.is_over() {
            self.dropped += self.hypotheses.len() - 1;
            return Decision::Initialize(self.hypotheses[own].evidence.clone());
        }
        Decision::Wait(self.waiting().unwrap_or(waiting))
    }

    /// Hypotheses that have one pose are one, with the evidence of the best of them.
    ///
    /// # Returns
    /// Where it is.
    fn join(&mut self, best: usize, with_pose: &[usize]) -> usize {
        let mut at = 0..self.hypotheses.len();
        self.hypotheses.retain(|_| at.next().is_some_and(|at| at == best || !with_pose.contains(&at)));
        self.dropped += with_pose.len() - 1;
        best - with_pose.iter().filter(|other| **other < best).count()
    }

    /// A new hypothesis; the weakest gives way to it.
    fn insert(&mut self, pose: FixedPose) -> usize {
        if self.hypotheses.len() == MAX_HYPOTHESES {
            let odds = |at: &usize| self.log_odds(&self.hypotheses[*at]);
            let weakest = (0..self.hypotheses.len()).min_by(|a, b| odds(a).total_cmp(&odds(b)));
            if let Some(at) = weakest {
                self.hypotheses.swap_remove(at);
            }
            self.dropped += 1;
        }
        self.hypotheses.push(Hypothesis::new(pose, PlaceEvidence::default()));
        self.hypotheses.len() - 1
    }

    /// What an operator says is evidence for the hypothesis that agrees with it, and the less the larger the area is in which it would.
    fn log_odds(&self, hypothesis: &Hypothesis) -> f64 {
        let expected = self.expected.filter(|expected| hypothesis.pose.agrees(expected));
        let by_operator = expected.map_or(0.0, |expected| {
            let wider = (expected.sigma_predicted(&hypothesis.pose) / EXPECTED_SIGMA_M).max(1.0);
            (REQUIRED_ODDS.ln() - 2.0 * wider.ln()).max(0.0)
        });
        hypothesis.evidence.log_odds() - hypothesis.displaced + by_operator
    }

    /// Takes in where the robot is according to its operator.
    pub fn expect(&mut self, expected: FixedPose) {
        self.expected = Some(expected);
    }

    /// Forgets where the robot is according to its operator.
    pub fn forget_expected(&mut self) {
        self.expected = None;
    }

    /// A hypothesis and its best alternative.
    fn against(&self, own: usize) -> Waiting {
        let others = self.hypotheses.iter().enumerate().filter(|(at, _)| *at != own);
        let alternative = others.map(|(_, other)| self.log_odds(other)).reduce(f64::max);
        let log_odds = self.log_odds(&self.hypotheses[own]);
        Waiting { log_odds, alternative: alternative.unwrap_or(0.0) }
    }

    /// What the best hypothesis lacks; `None` without any.
    pub fn waiting(&self) -> Option<Waiting> {
        let odds = |at: &usize| self.log_odds(&self.hypotheses[*at]);
        let best = (0..self.hypotheses.len()).max_by(|a, b| odds(a).total_cmp(&odds(b)))?;
        Some(self.against(best))
    }

    /// Hypotheses that were dropped since the last call: weaker than others.
    pub fn take_dropped(&mut self) -> usize {
        std::mem::take(&mut self.dropped)
    }

    /// Begins with the hypothesis that won against a state.
    ///
    /// # Arguments
    /// * `pose`: of the newest of its answers.
    pub fn begin_with(&mut self, map_version: u64, pose: FixedPose, evidence: PlaceEvidence) {
        self.map_version = Some(map_version);
        self.hypotheses.clear();
        self.hypotheses.push(Hypothesis::new(pose, evidence));
    }

    /// Odometry failed: answers from before say nothing about `global_from_local` any more, nor does the operator.
    pub fn note_odometry_failure(&mut self) {
        self.dropped += self.hypotheses.len();
        self.hypotheses.clear();
        self.expected = None;
    }

    /// Forgets all hypotheses: `global_from_local` is known.
    pub fn clear(&mut self) {
        self.hypotheses.clear();
        self.expected = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::{Pose, Rotation};
    use nalgebra::Vector3;
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};

    /// A fix of a robot that drives along x, `displaced` in G, at a wall where it is.
    fn fix(x: f64, displaced: f64, log_odds: f64) -> Fix {
        let local_from_imu = Pose::new(Rotation::identity(), Vector3::new(x, 0.0, 0.0));
        let at = Vector3::new(x, displaced, 0.0);
        let landmarks = [at - Vector3::z(), at + Vector3::z()];
        Fix {
            pose: FixedPose {
                global_from_imu: Pose::new(Rotation::identity(), at),
                local_from_imu,
                sigma_rotation: 0.005,
                sigma_position: 0.02,
            },
            seen: SeenPlace::of(&landmarks, log_odds, 0.0),
        }
    }

    fn initializes(first: &mut MapInitializer, fix: Fix) -> bool {
        matches!(first.add(1, fix), Decision::Initialize(_))
    }

    #[test]
    fn a_distinctive_view_initializes_with_its_first_answer() {
        assert!(initializes(&mut MapInitializer::default(), fix(0.0, 0.0, 4.0)));
    }

    #[test]
    fn one_place_of_moderate_evidence_never_initializes_and_three_places_do() {
        let mut first = MapInitializer::default();
        assert!((0..100).all(|_| !initializes(&mut first, fix(0.0, 0.0, 0.8))));
        assert!(!initializes(&mut first, fix(3.0, 0.0, 0.8)));
        assert!(initializes(&mut first, fix(6.0, 0.0, 0.8)));
    }

    #[test]
    fn an_alternative_must_be_worse_by_the_same_ratio() {
        let mut first = MapInitializer::default();
        assert!(!initializes(&mut first, fix(0.0, 5.0, 1.5)));
        assert!(!initializes(&mut first, fix(0.0, 0.0, 3.0)));
        assert!(initializes(&mut first, fix(3.0, 0.0, 2.0)));
        assert_eq!(first.take_dropped(), 1);
    }

    #[test]
    fn negative_evidence_counts_against() {
        let mut first = MapInitializer::default();
        assert!(!initializes(&mut first, fix(0.0, 0.0, -2.0)));
        assert!(!initializes(&mut first, fix(3.0, 0.0, 3.0)));
        let waiting = first.waiting().unwrap();
        assert!((waiting.log_odds - 1.0).abs() < 1e-12);
        assert_eq!(waiting.to_string(), "waits for a more distinctive view: odds 2.72 of 7");
    }

    /// The same with a standard deviation of the position, metres.
    fn vague(x: f64, displaced: f64, log_odds: f64, sigma_position: f64) -> Fix {
        let fix = fix(x, displaced, log_odds);
        Fix { pose: FixedPose { sigma_position, sigma_rotation: 0.05, ..fix.pose }, ..fix }
    }

    #[test]
    fn a_vague_answer_gives_no_wrong_aisle_its_evidence() {
        // Right, within 2.5 m of the next aisle, which looks alike.
        let mut first = MapInitializer::default();
        assert!(!initializes(&mut first, vague(0.0, 0.0, 1.5, 1.0)));
        for _ in 0..50 {
            assert!(!initializes(&mut first, fix(3.0, 2.5, 0.6)), "2.5 standard deviations beside it");
        }
        // The right aisle gets all of it.
        let mut first = MapInitializer::default();
        assert!(!initializes(&mut first, vague(0.0, 0.0, 1.5, 1.0)));
        assert!(initializes(&mut first, fix(3.0, 0.3, 0.6)));
    }

    #[test]
    fn an_answer_that_agrees_with_two_hypotheses_decides_nothing_between_them() {
        let mut first = MapInitializer::default();
        assert!(!initializes(&mut first, fix(0.0, 0.0, 1.0)));
        assert!(!initializes(&mut first, fix(0.0, 1.0, 1.1)));
        for x in [4.0, 8.0, 12.0] {
            assert!(!initializes(&mut first, vague(x, 0.5, 2.0, 1.0)));
        }
        assert!(initializes(&mut first, fix(16.0, 0.0, 2.5)));
    }

    /// Whether fixes of one place with these errors (m), at the start and 1.5 m further each, initialize.
    fn of_one_place(errors: &[f64], log_odds: f64) -> bool {
        let mut first = MapInitializer::default();
        let mut fixes = errors.iter().enumerate().map(|(k, error)| fix(1.5 * k as f64, *error, log_odds));
        fixes.any(|fix| initializes(&mut first, fix))
    }

    #[test]
    fn hypotheses_that_become_one_pose_are_one() {
        // The first two are apart, and the third between them.
        assert!(of_one_place(&[-0.07, 0.07, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], 0.5));
    }

    /// Errors that are twice as large as stated.
    #[test]
    fn right_answers_initialize_although_they_are_less_accurate_than_stated() {
        let mut rng = StdRng::seed_from_u64(5);
        for _ in 0..300 {
            let normal = |rng: &mut StdRng| (0..12).map(|_| rng.random_range(0.0..1.0)).sum::<f64>() - 6.0;
            let errors: Vec<f64> = (0..40).map(|_| 2.0 * 0.02 * normal(&mut rng)).collect();
            assert!(of_one_place(&errors, 0.6), "{errors:?}");
        }
    }

    #[test]
    fn the_most_certain_pose_of_a_hypothesis_is_kept() {
        let mut first = MapInitializer::default();
        assert!(!initializes(&mut first, fix(0.0, 0.0, 0.5)));
        assert!(!initializes(&mut first, vague(3.0, 1.0, 0.5, 1.0)));
        // It would agree with the vague one, and not with what is known: another place.
        assert!(!initializes(&mut first, fix(6.0, 2.0, 1.0)));
        assert_eq!(first.hypotheses.len(), 2);
    }

    #[test]
    fn what_won_against_a_state_is_weighed_with_what_comes_after_it() {
        let evidence: PlaceEvidence = [fix(0.0, 0.0, 2.5).seen].into_iter().collect();
        let mut first = MapInitializer::default();
        first.begin_with(1, fix(0.0, 0.0, 0.0).pose, evidence.clone());
        assert!(initializes(&mut first, fix(3.0, 0.0, 0.1)));
        first.begin_with(1, fix(0.0, 0.0, 0.0).pose, evidence);
        assert!(!initializes(&mut first, fix(3.0, 0.0, -1.0)), "what is not seen there counts against it");
    }

    #[test]
    fn what_the_operator_says_decides_between_places_that_look_alike() {
        let mut first = MapInitializer::default();
        let mut expected = fix(0.0, 0.0, 0.0).pose;
        expected.global_from_imu.translation.y += 1.0;
        (expected.sigma_position, expected.sigma_rotation) = (0.5, 0.2);
        first.expect(expected);
        assert!(!initializes(&mut first, fix(1.0, 8.0, 0.1)));
        assert!(!initializes(&mut first, fix(1.0, 0.0, 0.05)));
        assert!(initializes(&mut first, fix(4.0, 0.0, 0.1)));
    }

    #[test]
    fn what_the_operator_said_long_ago_decides_nothing() {
        let mut expected = fix(0.0, 0.0, 0.0).pose;
        (expected.sigma_position, expected.sigma_rotation) = (0.5, 0.26);
        let wins_after = |metres: f64, displaced: f64| {
            let mut first = MapInitializer::default();
            first.expect(expected);
            initializes(&mut first, fix(metres, displaced, 0.3))
        };
        assert!(wins_after(4.0, 0.0));
        // The heading that RViz states is off by 4 m after 16 m: the next aisle agrees as well.
        for displaced in [0.0, 4.0] {
            assert!(!wins_after(30.0, displaced));
        }
    }

    #[test]
    fn answers_from_before_a_failure_of_odometry_count_no_more() {
        let mut first = MapInitializer::default();
        assert!(!initializes(&mut first, fix(0.0, 0.0, 1.2)));
        first.note_odometry_failure();
        assert!(!initializes(&mut first, fix(3.0, 0.0, 1.2)));
        assert!(initializes(&mut first, fix(6.0, 0.0, 1.2)));
        assert_eq!(first.take_dropped(), 1);
    }

    #[test]
    fn another_version_of_the_map_starts_anew() {
        let mut first = MapInitializer::default();
        assert!(!initializes(&mut first, fix(0.0, 0.0, 1.2)));
        assert!(matches!(first.add(2, fix(3.0, 0.0, 1.2)), Decision::Wait(_)));
    }

    /// Of answers of a picture that repeats, the likelihood ratio exceeds `r` for at most one in `r`, whatever it is made of:
    /// its mean is one. Sums of independent ones exceed it at any time with at most the same probability.
    #[test]
    fn pictures_that_repeat_initialize_at_most_at_the_stated_rate() {
        let (runs, places) = (2000, 30);
        let mut rng = StdRng::seed_from_u64(1);
        let mut counts = [0; 2];
        for (count, sign) in counts.iter_mut().zip([-1.0, 1.0]) {
            for _ in 0..runs {
                let mut first = MapInitializer::default();
                // Two normal distributions of the score, one standard deviation apart.
                let mut is_fixed = (0..places).map(|k| {
                    let normal = (0..12).map(|_| rng.random_range(0.0..1.0)).sum::<f64>() - 6.0;
                    initializes(&mut first, fix(3.0 * f64::from(k), 0.0, normal + 0.5 * sign))
                });
                *count += usize::from(is_fixed.any(|fixed| fixed));
            }
        }
        let [wrong, right] = counts;
        assert!((wrong as f64) < f64::from(runs) / REQUIRED_ODDS * 1.1, "{wrong} of {runs}");
        assert!(right as f64 > 0.99 * f64::from(runs), "{right} of {runs}");
    }
}
