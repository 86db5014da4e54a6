//! A watch over the map: how far its answers move the pose in G against odometry, and how far they may.
//!
//! An answer is tested against the state when it comes, and one that moves the pose by a little passes. Each correction of a
//! consistent filter is independent of the others, so that those of many answers add up to no more than the pose's
//! uncertainty at their begin and what odometry added to it. A map that moves by a little with each answer adds up in one
//! direction. `docs/src/derivations/watch.md` derives the test and what it detects.

use crate::state::rotation_adjoint;
use geometry::{Pose, PoseWithCovariance};
use nalgebra::{Matrix6, SymmetricEigen, Vector3, Vector6};
use std::collections::VecDeque;

/// Answers that are looked back at.
const ANSWERS: usize = 64;
/// Squared Mahalanobis distance of a sum of corrections beyond which it is an alarm: chi-square with six degrees of freedom,
/// 1 - 1e-6.
const ALARM: f64 = 38.3;
/// The same up to which corrections are plausible: 99 %. Beyond, the claimed covariance is enlarged.
const PLAUSIBLE: f64 = 16.8;
/// The same below which an alarm ends: 95 %.
const AGREES: f64 = 12.6;
/// An alarm ends when no further corrections contradict odometry for this time, nanoseconds: a map that stays where it is
/// then cannot be told from one that was always there.
const HOLD_NS: i64 = 120_000_000_000;

/// The pose in G after an answer.
#[derive(Clone, Copy, Debug)]
struct AfterAnswer {
    global_from_imu: PoseWithCovariance,
    local_from_imu: PoseWithCovariance,
}

/// Sums up to an answer, of errors of G: `[δθ, δp]` at the origin of the watch, wherever the robot was.
#[derive(Clone, Copy, Debug)]
struct Sums {
    stamp_ns: i64,
    /// Of all corrections.
    correction: Vector6<f64>,
    /// Of the covariances that odometry added between the answers.
    growth: Matrix6<f64>,
    /// Covariance of the pose in G after the answer.
    claimed: Matrix6<f64>,
}

impl Sums {
    /// What the answers since `begin` may move the pose by.
    fn allowed_since(&self, begin: &Self) -> Matrix6<f64> {
        begin.claimed + self.growth - begin.growth
    }

    /// What the answers since `begin` moved the pose by, and its squared Mahalanobis distance.
    fn since(&self, begin: &Self) -> (Vector6<f64>, f64) {
        let moved = self.correction - begin.correction;
        let allowed = self.allowed_since(begin);
        let squared = allowed.cholesky().map_or(0.0, |factor| moved.dot(&factor.solve(&moved)));
        (moved, squared)
    }
}

/// Corrections that odometry cannot explain.
#[derive(Clone, Copy, Debug)]
struct Contradiction {
    begin: Sums,
    /// The newest answer that contradicts odometry, nanoseconds.
    newest_ns: i64,
}

/// A map that moves against odometry.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "answers of {seconds:.0} s moved the pose in the map by {position_m:.2} m and {rotation_deg:.1} deg against odometry, more than \
     both allow: the map moves, its server sends wrong poses, or the odometry failed (carried, cameras covered); the covariance of the \
     pose in the map is enlarged by as much. Check the pose at a known place, and who serves the map"
)]
pub struct MapDrift {
    /// Time since the answer before it began.
    pub seconds: f64,
    /// Distance.
    pub position_m: f64,
    /// Angle.
    pub rotation_deg: f64,
}

/// How much worse a pose in G may be than the filter believes.
#[derive(Clone, Debug, Default, PartialEq)]
enum Doubt {
    #[default]
    None,
    /// G may have errors of this covariance, `[δθ, δp]` at the origin of the watch.
    Covariance(Box<Matrix6<f64>>),
    /// G may be off by this error, `[δθ, δp]` at the origin of the watch.
    Error(Vector6<f64>),
}

/// The watch.
#[derive(Clone, Debug, Default)]
pub(crate) struct MapWatch {
    /// A place in G, near the robot: errors of G are referred to it.
    origin: Vector3<f64>,
    sums: VecDeque<Sums>,
    last: Option<AfterAnswer>,
    alarm: Option<Contradiction>,
    doubt: Doubt,
}

impl MapWatch {
    /// The pose in G before an answer where the state has none: the last one, moved on by odometry.
    pub(crate) fn predict(&self, local_from_imu: &PoseWithCovariance) -> Option<PoseWithCovariance> {
        let last = self.last?;
        let before = last.local_from_imu;
        let moved = before.pose.inverse() * local_from_imu.pose;
        let pose = last.global_from_imu.pose * moved;
        let global_from_local = rotation_adjoint(&(last.global_from_imu.pose * before.pose.inverse()));
        let carried = referred(&before, &local_from_imu.pose.translation);
        let added = global_from_local
            * positive_part(&(local_from_imu.covariance - carried))
            * global_from_local.transpose();
        Some(PoseWithCovariance::new(pose, referred(&last.global_from_imu, &pose.translation) + added))
    }

    /// Takes in an answer that updated the state.
    ///
    /// # Arguments
    /// * `predicted`: the pose in G before it; `None` for the first answer.
    /// * `updated`: the same after it.
    pub(crate) fn note(
        &mut self,
        stamp_ns: i64,
        predicted: Option<&PoseWithCovariance>,
        updated: &PoseWithCovariance,
        local_from_imu: &PoseWithCovariance,
    ) {
        let before =
            self.last.replace(AfterAnswer { global_from_imu: *updated, local_from_imu: *local_from_imu });
        let (Some(sums), Some(before), Some(predicted)) = (self.sums.back().copied(), before, predicted)
        else {
            self.origin = updated.pose.translation;
            let (correction, growth) = (Vector6::zeros(), Matrix6::zeros());
            self.sums.push_back(Sums { stamp_ns, correction, growth, claimed: updated.covariance });
            return;
        };
        let added = referred(predicted, &self.origin) - referred(&before.global_from_imu, &self.origin);
        let moved = predicted.pose.local(&updated.pose);
        let now = Sums {
            stamp_ns,
            correction: sums.correction + moved_to(&updated.pose.translation, &self.origin) * moved,
            growth: sums.growth + positive_part(&added),
            claimed: referred(updated, &self.origin),
        };
        self.judge(&now);
        if self.sums.len() == ANSWERS {
            self.sums.pop_front();
        }
        self.sums.push_back(now);
    }

    fn judge(&mut self, now: &Sums) {
        let since_ns = self.alarm.map_or(i64::MIN, |alarm| alarm.newest_ns);
        let begins = self.sums.iter().filter(|sums| sums.stamp_ns >= since_ns);
        let worst =
            begins.map(|begin| (*begin, now.since(begin))).max_by(|(_, (_, a)), (_, (_, b))| a.total_cmp(b));
        if let Some((begin, (_, squared))) = worst
            && squared > ALARM
        {
            let begin = self.alarm.map_or(begin, |alarm| alarm.begin);
            self.alarm = Some(Contradiction { begin, newest_ns: now.stamp_ns });
        }
        let of_alarm = self.alarm.map(|alarm| (alarm, now.since(&alarm.begin)));
        match of_alarm {
            Some((alarm, (moved, squared)))
                if squared > AGREES && now.stamp_ns - alarm.newest_ns <= HOLD_NS =>
            {
                self.doubt = Doubt::Error(moved);
            }
            Some(_) => {
                self.alarm = None;
                self.doubt = Doubt::None;
                self.sums.clear();
            }
            None => self.doubt = self.doubt_without_alarm(now),
        }
    }

    /// What the implausible sums say of the error of G: the mean of their squares and covariances, of which the more is taken
    /// the less plausible they are.
    fn doubt_without_alarm(&self, now: &Sums) -> Doubt {
        let (mut total, mut largest, mut sum) = (0.0, 0.0_f64, Matrix6::zeros());
        for begin in &self.sums {
            let (moved, squared) = now.since(begin);
            let weight = (squared - PLAUSIBLE) / (ALARM - PLAUSIBLE);
            if weight > 0.0 {
                total += weight;
                largest = largest.max(weight);
                sum += (moved * moved.transpose() + now.allowed_since(begin)) * weight;
            }
        }
        if total > 0.0 { Doubt::Covariance(Box::new(sum * (largest / total))) } else { Doubt::None }
    }

    /// The alarm, as long as it lasts.
    pub(crate) fn alarm(&self) -> Option<MapDrift> {
        let (Doubt::Error(moved), Some(alarm)) = (&self.doubt, self.alarm) else { return None };
        let newest = self.sums.back()?;
        Some(MapDrift {
            seconds: (newest.stamp_ns - alarm.begin.stamp_ns) as f64 * 1e-9,
            position_m: self.error_at(moved, &self.last?.global_from_imu.pose).fixed_rows::<3>(3).norm(),
            rotation_deg: moved.fixed_rows::<3>(0).norm().to_degrees(),
        })
    }

    /// A pose in G with the covariance that is claimed for it: enlarged by what G may err by, during an alarm in every
    /// direction.
    pub(crate) fn claimed(&self, filtered: &PoseWithCovariance) -> PoseWithCovariance {
        let covariance = match &self.doubt {
            Doubt::None => filtered.covariance,
            Doubt::Covariance(at_origin) => {
                let adjoint = moved_to(&self.origin, &filtered.pose.translation);
                filtered.covariance + adjoint * **at_origin * adjoint.transpose()
            }
            Doubt::Error(moved) => {
                let error = self.error_at(moved, &filtered.pose);
                let [rotation, position] = [0, 3].map(|part| error.fixed_rows::<3>(part).norm_squared());
                let added = Vector6::from_fn(|k, _| if k < 3 { rotation } else { position });
                filtered.covariance + Matrix6::from_diagonal(&added)
            }
        };
        PoseWithCovariance { covariance, ..*filtered }
    }

    /// An error of G at the origin of the watch, at a pose.
    fn error_at(&self, error: &Vector6<f64>, pose: &Pose) -> Vector6<f64> {
        moved_to(&self.origin, &pose.translation) * error
    }
}

/// Takes an error of G, `[δθ, δp]`, from one place to another: `δp_to = δp_from + δθ × (to − from)`.
fn moved_to(from: &Vector3<f64>, to: &Vector3<f64>) -> Matrix6<f64> {
    let mut adjoint = Matrix6::identity();
    adjoint.fixed_view_mut::<3, 3>(3, 0).copy_from(&(from - to).cross_matrix());
    adjoint
}

/// The covariance of a pose, referred to a place.
fn referred(pose: &PoseWithCovariance, place: &Vector3<f64>) -> Matrix6<f64> {
    let adjoint = moved_to(&pose.pose.translation, place);
    adjoint * pose.covariance * adjoint.transpose()
}

/// A symmetric matrix without its negative eigenvalues.
fn positive_part(of: &Matrix6<f64>) -> Matrix6<f64> {
    let SymmetricEigen { eigenvectors, eigenvalues } = SymmetricEigen::new((of + of.transpose()) * 0.5);
    eigenvectors * Matrix6::from_diagonal(&eigenvalues.map(|value| value.max(0.0))) * eigenvectors.transpose()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};

    /// What odometry adds between two answers, and what an answer is off by, metres and rad per axis.
    const ODOMETRY: f64 = 0.01;
    const ANSWER: f64 = 0.03;

    /// A Kalman filter of the pose in G, in scalars: all axes are equal and independent.
    struct Filter {
        watch: MapWatch,
        error: Vector6<f64>,
        variance: f64,
        stamp_ns: i64,
        random: StdRng,
    }

    impl Filter {
        fn new(seed: u64) -> Self {
            let random = StdRng::seed_from_u64(seed);
            let (error, variance) = (Vector6::zeros(), ANSWER.powi(2));
            Self { watch: MapWatch::default(), error, variance, stamp_ns: 0, random }
        }

        fn noise(&mut self, sigma: f64) -> Vector6<f64> {
            // Sum of twelve uniform numbers: variance 1.
            let mut normal = || (0..12).map(|_| self.random.random::<f64>()).sum::<f64>() - 6.0;
            Vector6::from_fn(|_, _| normal() * sigma)
        }

        fn pose(&self) -> PoseWithCovariance {
            PoseWithCovariance::new(
                Pose::identity().retract(&self.error),
                Matrix6::identity() * self.variance,
            )
        }

        /// An answer of a map that is off by `lie`.
        fn answer(&mut self, lie: &Vector6<f64>) {
            self.stamp_ns += 500_000_000;
            let drift = self.noise(ODOMETRY);
            self.error += drift;
            self.variance += ODOMETRY.powi(2);
            let predicted = (self.stamp_ns > 500_000_000).then(|| self.pose());
            let gain = self.variance / (self.variance + ANSWER.powi(2));
            let measured = lie + self.noise(ANSWER);
            self.error += gain * (measured - self.error);
            self.variance *= 1.0 - gain;
            let local = PoseWithCovariance::new(Pose::identity(), Matrix6::zeros());
            self.watch.note(self.stamp_ns, predicted.as_ref(), &self.pose(), &local);
        }

        /// NEES of what is claimed, over six.
        fn nees(&self) -> f64 {
            self.watch.claimed(&self.pose()).nees(&Pose::identity()).unwrap() / 6.0
        }
    }

    #[test]
    fn honest_maps_raise_no_alarm_and_are_believed() {
        let (mut nees, mut doubted) = (0.0, 0);
        for seed in 0..20 {
            let mut filter = Filter::new(seed);
            for _ in 0..1000 {
                filter.answer(&Vector6::zeros());
                assert_eq!(filter.watch.alarm(), None, "seed {seed}");
                nees += filter.nees() / 20_000.0;
                doubted += usize::from(filter.watch.doubt != Doubt::None);
            }
        }
        assert!(doubted < 1000, "{doubted} of 20000");
        assert!((0.95..1.05).contains(&nees), "NEES {nees}");
    }

    #[test]
    fn a_map_that_moves_slowly_raises_the_alarm_within_half_a_metre_and_is_not_believed_to_centimetres() {
        for seed in 0..20 {
            let mut filter = Filter::new(seed);
            (0..100).for_each(|_| filter.answer(&Vector6::zeros()));
            let mut lie = Vector6::zeros();
            let mut alarm_m = None;
            for _ in 0..100 {
                lie[3] += 0.05;
                filter.answer(&lie);
                let moved = filter.error.fixed_rows::<3>(3).norm();
                alarm_m = alarm_m.or(filter.watch.alarm().map(|_| moved));
                assert!(filter.nees() < 9.0, "seed {seed}: NEES {} at {moved} m", filter.nees());
            }
            assert!(alarm_m.is_some_and(|metres| metres < 0.5), "seed {seed}: {alarm_m:?}");
        }
    }

    #[test]
    fn an_alarm_ends_when_the_map_comes_back_or_stays_for_two_minutes() {
        for (back, answers) in [(true, 10), (false, 250)] {
            let mut filter = Filter::new(1);
            let mut lie = Vector6::zeros();
            (0..100).for_each(|_| filter.answer(&lie));
            lie[4] = 2.0;
            (0..10).for_each(|_| filter.answer(&lie));
            let drift = filter.watch.alarm().unwrap();
            assert!((drift.position_m - 2.0).abs() < 0.3 && drift.seconds < 10.0, "{drift:?}");
            if back {
                lie[4] = 0.0;
            }
            let mut left = answers;
            while filter.watch.alarm().is_some() {
                assert!(left > 0, "back {back}");
                left -= 1;
                filter.answer(&lie);
            }
            // With its end, what is claimed is what the answers allow.
            assert_eq!(filter.watch.claimed(&filter.pose()), filter.pose());
            (0..left).for_each(|_| filter.answer(&lie));
            assert_eq!(filter.watch.alarm(), None, "back {back}");
        }
    }

    #[test]
    fn doubt_of_a_rotation_grows_with_the_distance() {
        let doubt = Doubt::Error(Vector6::new(0.0, 0.0, 0.1, 0.0, 0.0, 0.0));
        let watch = MapWatch { doubt, ..MapWatch::default() };
        let claimed = |watch: &MapWatch, x: f64| {
            let pose = Pose::new(geometry::Rotation::identity(), Vector3::x() * x);
            watch.claimed(&PoseWithCovariance::new(pose, Matrix6::zeros())).covariance
        };
        let at = |x: f64| claimed(&watch, x);
        assert!((at(10.0)[(4, 4)] - 1.0).abs() < 1e-12 && (at(10.0)[(2, 2)] - 0.01).abs() < 1e-12);
        assert!(at(0.0)[(4, 4)] < 1e-12);
        assert_eq!(claimed(&MapWatch::default(), 0.0), Matrix6::zeros());
    }
}
