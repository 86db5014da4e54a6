//! Invalidation is conservative, however the errors of the new map version depend on the old ones.

use crate::schmidt::dense_filter::{BLOCK, Correlation, DenseFilter, FIXED, Map, POSE, some_keyframes, spd};
use crate::schmidt::eviction::{ROUNDING, margin, update};
use estimator::covariance::JointCovariance;
use nalgebra::DMatrix;
use rand::{SeedableRng, rngs::StdRng};

const KEYFRAMES: u64 = 32;
/// In every run of the tests, and in the nightly one.
const STEPS_A_VERSION: usize = 35;
const ALL_STEPS_A_VERSION: usize = 60;
const VERSIONS: usize = 4;
const MAX_ACTIVE: usize = 6;
const MAX_HELD: usize = 14;
const CORRELATIONS: [Correlation; 3] =
    [Correlation::None, Correlation::Blocks, Correlation::BlocksAndCommon(12)];

/// How the errors of the new version depend on those of the old one.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Change {
    /// They are the same.
    Same,
    /// They have the opposite sign.
    Opposite,
    /// Those of every other block are opposite, the rest stays as it is and held.
    HalfOpposite,
    /// They are the same under other names.
    OtherNames,
}

impl Change {
    /// The keyframes that the map lists as changed.
    fn other_errors(self) -> Vec<u64> {
        let is_other = |id: &u64| self != Self::HalfOpposite || (id / BLOCK).is_multiple_of(2);
        (0..KEYFRAMES).filter(is_other).collect()
    }

    fn apply(self, map: Map, truth: &mut DenseFilter) -> Map {
        let n = POSE * KEYFRAMES as usize;
        let mut turn = DMatrix::<f64>::identity(n, n);
        match self {
            Self::Same => return map,
            Self::Opposite => turn.neg_mut(),
            Self::HalfOpposite => {
                for id in self.other_errors() {
                    let begin = POSE * id as usize;
                    (begin..begin + POSE).for_each(|k| turn[(k, k)] = -1.0);
                }
            }
            Self::OtherNames => {
                let shift = POSE * BLOCK as usize;
                turn = DMatrix::from_fn(n, n, |row, column| f64::from((row + shift) % n == column));
                truth.turn_map(&turn);
                return map.renamed();
            }
        }
        truth.turn_map(&turn);
        map.opposite(&self.other_errors())
    }
}

struct Outcome {
    /// Least eigenvalue of stated minus true covariance over the largest of the true one, at its worst.
    worst: f64,
    /// Stated over true variance of the state at the end, mean over its numbers.
    excess: f64,
}

/// Runs through some map versions; `naive`: drops changed keyframes without inflating any covariance.
fn run(seed: u64, correlation: Correlation, change: Change, steps_a_version: usize, naive: bool) -> Outcome {
    let mut rng = StdRng::seed_from_u64(seed);
    let start = spd(&mut rng, FIXED, 0.1);
    let max_active = if naive { KEYFRAMES as usize } else { MAX_ACTIVE };
    let mut joint = JointCovariance::new(start.clone(), max_active);
    let mut map = Map::new(&mut rng, KEYFRAMES, 0.1, correlation);
    let mut truth = DenseFilter::new(&start, &map);
    let mut worst = f64::INFINITY;
    for version in 0..VERSIONS {
        if version > 0 {
            map = change.apply(map, &mut truth);
            if naive {
                joint.held.remove_unused(&change.other_errors());
            } else {
                let stayed: Vec<u64> =
                    joint.held.ids().filter(|id| !change.other_errors().contains(id)).collect();
                joint.invalidate(&change.other_errors());
                assert_eq!(joint.held.len(), stayed.len());
                assert!(joint.held.ids().all(|id| stayed.contains(&id)));
            }
        }
        for _ in 0..steps_a_version {
            truth.random_step(&mut rng, &mut joint);
            let ids = some_keyframes(&mut rng, KEYFRAMES);
            map.activate(&ids, &mut joint, true);
            update(&mut rng, &mut joint, &mut truth, &ids);
            joint.held.deactivate_unused();
            if !naive {
                joint.evict(MAX_HELD);
            }
            worst = worst.min(margin(&joint, &truth));
        }
    }
    let (stated, of_active) = (joint.active(), truth.of_active());
    let ratios = (0..truth.active).map(|k| stated[(k, k)] / of_active[(k, k)]);
    Outcome { worst, excess: ratios.sum::<f64>() / truth.active as f64 }
}

#[test]
fn a_changed_map_never_makes_the_filter_overconfident() {
    never_overconfident(STEPS_A_VERSION);
}

#[test]
#[ignore = "more steps"]
fn a_changed_map_never_makes_the_filter_overconfident_in_more_steps() {
    never_overconfident(ALL_STEPS_A_VERSION);
}

fn never_overconfident(steps_a_version: usize) {
    for change in [Change::Same, Change::Opposite, Change::HalfOpposite, Change::OtherNames] {
        for (seed, correlation) in CORRELATIONS.into_iter().enumerate() {
            let outcome = run(seed as u64, correlation, change, steps_a_version, false);
            assert!(
                outcome.worst > -ROUNDING,
                "{change:?}, {seed}: stated below true by {:e}",
                outcome.worst
            );
            // An arbitrarily large covariance would be conservative, too.
            assert!(outcome.excess < 2.0, "{change:?}, {seed}: states {} times its variance", outcome.excess);
        }
    }
}

#[test]
fn treating_the_new_version_as_independent_would_make_it_overconfident() {
    for steps_a_version in [STEPS_A_VERSION, ALL_STEPS_A_VERSION] {
        for (seed, correlation) in CORRELATIONS.into_iter().enumerate() {
            let outcome = run(seed as u64, correlation, Change::Same, steps_a_version, true);
            assert!(outcome.worst < -1e-3, "seed {seed}: the law above has no power, {:e}", outcome.worst);
        }
    }
}

#[test]
fn nothing_is_lost_where_no_error_is_another() {
    let mut rng = StdRng::seed_from_u64(3);
    let start = spd(&mut rng, FIXED, 0.1);
    let mut joint = JointCovariance::new(start.clone(), MAX_ACTIVE);
    let map = Map::new(&mut rng, KEYFRAMES, 0.1, Correlation::Blocks);
    let mut truth = DenseFilter::new(&start, &map);
    for _ in 0..20 {
        truth.random_step(&mut rng, &mut joint);
        map.activate(&[4, 5, 9], &mut joint, true);
        update(&mut rng, &mut joint, &mut truth, &[4, 5, 9]);
    }
    let before = joint.active().view().into_owned();
    joint.invalidate(&[]);
    joint.invalidate(&[0, 1, 2]);
    assert_eq!(joint.active().view(), before);
    assert_eq!(joint.held.len(), 3);
}
