//! Giving up what a changed map knows better stays conservative, however the new errors depend on the old ones.

use crate::budget::{ROUNDING, margin, update};
use crate::textbook::{BLOCK, FIXED, Map, POSE, Textbook, some_keyframes, spd};
use estimator::covariance::JointCovariance;
use nalgebra::DMatrix;
use rand::{SeedableRng, rngs::StdRng};

const KEYFRAMES: u64 = 32;
const STEPS_A_VERSION: usize = 60;
const VERSIONS: usize = 4;
const MOST_ACTIVE: usize = 6;
const MOST_HELD: usize = 14;

/// How the errors of the new version depend on those of the old one.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Change {
    /// They are the same, only nobody knows.
    Same,
    /// As against each other as can be.
    Opposite,
    /// Those of every other block are opposite, the rest stays as it is and held.
    HalfOpposite,
    /// They are the same under other names.
    OtherNames,
}

impl Change {
    /// The keyframes that the news list.
    fn other_errors(self) -> Vec<u64> {
        let is_other = |id: &u64| self != Self::HalfOpposite || (id / BLOCK).is_multiple_of(2);
        (0..KEYFRAMES).filter(is_other).collect()
    }

    fn apply(self, map: Map, truth: &mut Textbook) -> Map {
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
        map
    }
}

struct Outcome {
    /// Least eigenvalue of stated minus true covariance over the largest of the true one, at its worst.
    worst: f64,
    /// Stated over true variance of the state at the end, mean over its numbers.
    excess: f64,
}

/// Lives through some versions; `forgets`: gives up without becoming more uncertain.
fn run(seed: u64, correlated: bool, change: Change, forgets: bool) -> Outcome {
    let mut rng = StdRng::seed_from_u64(seed);
    let start = spd(&mut rng, FIXED, 0.1);
    let most_active = if forgets { KEYFRAMES as usize } else { MOST_ACTIVE };
    let mut joint = JointCovariance::new(start.clone(), most_active);
    let mut map = Map::new(&mut rng, KEYFRAMES, 0.1, correlated);
    let mut truth = Textbook::new(&start, &map);
    let mut worst = f64::INFINITY;
    for version in 0..VERSIONS {
        if version > 0 {
            map = change.apply(map, &mut truth);
            if forgets {
                joint.held.remove_unused(&change.other_errors());
            } else {
                let stayed: Vec<u64> =
                    joint.held.ids().filter(|id| !change.other_errors().contains(id)).collect();
                joint.invalidate(&change.other_errors());
                assert_eq!(joint.held.len(), stayed.len());
                assert!(joint.held.ids().all(|id| stayed.contains(&id)));
            }
        }
        for _ in 0..STEPS_A_VERSION {
            truth.move_on(&mut rng, &mut joint);
            let ids = some_keyframes(&mut rng, KEYFRAMES);
            map.pull(&ids, &mut joint, true);
            update(&mut rng, &mut joint, &mut truth, &ids);
            joint.held.deactivate_unused();
            if !forgets {
                joint.evict(MOST_HELD);
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
    for change in [Change::Same, Change::Opposite, Change::HalfOpposite, Change::OtherNames] {
        for (seed, correlated) in [(0, false), (1, true)] {
            let outcome = run(seed, correlated, change, false);
            assert!(
                outcome.worst > -ROUNDING,
                "{change:?}, {seed}: stated below true by {:e}",
                outcome.worst
            );
            // A filter that states that it knows nothing is conservative, too.
            assert!(outcome.excess < 2.0, "{change:?}, {seed}: states {} times its variance", outcome.excess);
        }
    }
}

#[test]
fn taking_the_new_version_for_independent_would_make_it_overconfident() {
    for (seed, correlated) in [(0, false), (1, true)] {
        let outcome = run(seed, correlated, Change::Same, true);
        assert!(outcome.worst < -1e-3, "seed {seed}: the law above has no power, {:e}", outcome.worst);
    }
}

#[test]
fn nothing_is_lost_where_no_error_is_another() {
    let mut rng = StdRng::seed_from_u64(3);
    let start = spd(&mut rng, FIXED, 0.1);
    let mut joint = JointCovariance::new(start.clone(), MOST_ACTIVE);
    let map = Map::new(&mut rng, KEYFRAMES, 0.1, true);
    let mut truth = Textbook::new(&start, &map);
    for _ in 0..20 {
        truth.move_on(&mut rng, &mut joint);
        map.pull(&[4, 5, 9], &mut joint, true);
        update(&mut rng, &mut joint, &mut truth, &[4, 5, 9]);
    }
    let before = joint.active().view().into_owned();
    joint.invalidate(&[]);
    joint.invalidate(&[0, 1, 2]);
    assert_eq!(joint.active().view(), before);
    assert_eq!(joint.held.len(), 3);
}
