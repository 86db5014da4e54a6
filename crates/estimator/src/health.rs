//! Whether the estimate can still be believed, and in words why not.
//!
//! A filter that is wrong does not notice by itself: its covariance stays small while its gates throw away the
//! measurements that would tell. So the watch looks at what cannot be in a filter that is right: tracks that
//! contradict it for seconds on end, speeds and biases that no body and no sensor has, and a velocity that nothing
//! holds any more.

use crate::EstimatorError;
use crate::config::EstimatorConfig;
use crate::covariance::JointCovariance;
use crate::initialization::static_initialization::InitialState;
use crate::odometry::track_update::TrackReport;
use crate::propagation::{ACCELEROMETER_BIAS, GYROSCOPE_BIAS, ImuState, VELOCITY};
use crate::state::ActiveState;
use nalgebra::Vector3;
use std::collections::VecDeque;

/// How long tracks must contradict the state, nanoseconds. A real flight (`v202`) has one second and a half in which
/// nearly all are gated, and recovers.
const CONTRADICTED_NS: i64 = 3_000_000_000;
/// Finished tracks that are enough to judge by in that time.
const ENOUGH_TRACKS: usize = 40;
/// Part of the tracks that agree, below which the state is wrong. Good runs keep above 0.8 over three seconds on
/// simulated tracks and above 0.17 on real ones; wrong starts, extrinsics that are off by 30 degrees and random tracks
/// fall below 0.06.
const LEAST_AGREEMENT: f64 = 0.10;
/// The same over the newest image alone, below which its pose is not handed on.
const SUSPICIOUS_AGREEMENT: f64 = 0.5;
/// Speed that no robot of this kind reaches, m/s.
const FASTEST: f64 = 100.0;
/// How many standard deviations a bias may be from what was believed at the start.
const BIAS_SIGMAS: f64 = 10.0;
/// Standard deviation of the velocity from which on there is nothing to go by, m/s. A run with an image every few
/// seconds, held by the map alone, comes to 1 to 2.
const LOOSEST_VELOCITY: f64 = 10.0;

/// The tracks of one image.
#[derive(Clone, Copy, Debug)]
struct Counts {
    stamp_ns: i64,
    agreed: usize,
    finished: usize,
    dropped: usize,
}

/// Watches one filter from its start on.
#[derive(Clone, Debug)]
pub struct Health {
    start_ns: i64,
    gyroscope_bias: (Vector3<f64>, Vector3<f64>),
    accelerometer_bias: (Vector3<f64>, Vector3<f64>),
    walk: (f64, f64),
    images: VecDeque<Counts>,
}

impl Health {
    /// A watch over a filter that starts from `initial`.
    pub fn new(initial: &InitialState, config: &EstimatorConfig) -> Self {
        let variances = |begin: usize| initial.covariance.diagonal().fixed_rows::<3>(begin).into_owned();
        Self {
            start_ns: initial.stamp_ns,
            gyroscope_bias: (initial.imu.gyroscope_bias, variances(GYROSCOPE_BIAS)),
            accelerometer_bias: (initial.imu.accelerometer_bias, variances(ACCELEROMETER_BIAS)),
            walk: (config.imu_noise.gyroscope_walk, config.imu_noise.accelerometer_walk),
            images: VecDeque::new(),
        }
    }

    /// Notes what became of the tracks of an image.
    pub fn note_tracks(&mut self, stamp_ns: i64, report: &TrackReport) {
        self.images.push_back(Counts {
            stamp_ns,
            agreed: report.used + report.landmarks,
            finished: report.used
                + report.gated
                + report.not_triangulated
                + report.landmarks
                + report.landmarks_gated,
            dropped: report.gated + report.landmarks_gated + report.dropped_observations,
        });
        // One image older than the time stays, so that the rest covers it.
        while self.images.get(1).is_some_and(|second| stamp_ns - second.stamp_ns >= CONTRADICTED_NS) {
            self.images.pop_front();
        }
    }

    /// Whether most tracks of the newest second contradict the state: its pose is not to be built on.
    pub fn is_suspicious(&self) -> bool {
        let newest_ns = self.images.back().map_or(0, |image| image.stamp_ns);
        let newest = self.images.iter().filter(|image| newest_ns - image.stamp_ns < CONTRADICTED_NS / 3);
        agreement(newest).is_some_and(|(part, _)| part < SUSPICIOUS_AGREEMENT)
    }

    /// Whether the estimate can be believed.
    ///
    /// # Errors
    /// [`EstimatorError::Diverged`] says why not.
    pub fn check(&self, state: &ActiveState, covariance: &JointCovariance) -> Result<(), EstimatorError> {
        match self.trouble(state, covariance) {
            Some(why) => Err(EstimatorError::Diverged(why)),
            None => Ok(()),
        }
    }

    fn trouble(&self, state: &ActiveState, covariance: &JointCovariance) -> Option<String> {
        if !state.is_finite() {
            return Some("a state is not a number".into());
        }
        let variance = |k: usize| covariance.active()[(k, k)];
        if (0..state.dim()).any(|k| variance(k).is_nan() || variance(k) < 0.0) {
            return Some("a variance is negative".into());
        }
        let loose = (VELOCITY..VELOCITY + 3).map(variance).fold(0.0, f64::max).sqrt();
        if loose > LOOSEST_VELOCITY {
            return Some(format!(
                "nothing holds the velocity any more (known to {loose:.1} m/s): no tracks?"
            ));
        }
        self.implausible(&state.imu, state.stamp_ns).or_else(|| self.contradicted())
    }

    /// A motion or a sensor that cannot be.
    fn implausible(&self, imu: &ImuState, stamp_ns: i64) -> Option<String> {
        let speed = imu.velocity.norm();
        if speed > FASTEST {
            return Some(format!("{speed:.0} m/s is faster than any robot"));
        }
        let seconds = (stamp_ns - self.start_ns) as f64 * 1e-9;
        let far = |value: &Vector3<f64>, (start, variance): &(Vector3<f64>, Vector3<f64>), walk: f64| {
            let allowed = variance.map(|variance| BIAS_SIGMAS * (variance + walk * walk * seconds).sqrt());
            (0..3).any(|k| (value[k] - start[k]).abs() > allowed[k])
        };
        if far(&imu.gyroscope_bias, &self.gyroscope_bias, self.walk.0) {
            let bias = imu.gyroscope_bias.norm();
            return Some(format!("a gyroscope bias of {bias:.2} rad/s is not what it started with"));
        }
        if far(&imu.accelerometer_bias, &self.accelerometer_bias, self.walk.1) {
            let bias = imu.accelerometer_bias.norm();
            return Some(format!("an accelerometer bias of {bias:.2} m/s^2 is not what it started with"));
        }
        None
    }

    /// Tracks that contradict the state for seconds on end.
    fn contradicted(&self) -> Option<String> {
        let span_ns = self.images.back()?.stamp_ns - self.images.front()?.stamp_ns;
        let (part, finished) = agreement(self.images.iter())?;
        let long_enough = span_ns >= CONTRADICTED_NS && finished >= ENOUGH_TRACKS;
        (long_enough && part < LEAST_AGREEMENT).then(|| {
            let seconds = span_ns as f64 * 1e-9;
            format!("{:.0} % of {finished} tracks contradict it for {seconds:.1} s", 100.0 * (1.0 - part))
        })
    }
}

/// The part of the tracks that agree, and how many there were; `None` without any.
///
/// A track that cannot be triangulated contradicts where outliers were dropped from it in vain, and tells nothing
/// where it has no parallax. Which it was is not known of each, so the kinder of both counts is taken.
fn agreement<'a>(images: impl Iterator<Item = &'a Counts>) -> Option<(f64, usize)> {
    let (mut agreed, mut finished, mut dropped) = (0, 0, 0);
    for image in images {
        agreed += image.agreed;
        finished += image.finished;
        dropped += image.dropped;
    }
    let part = |of: usize| agreed as f64 / of.max(1) as f64;
    (finished > 0).then(|| (part(finished).max(part(agreed + dropped)), finished))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn watch() -> Health {
        let imu = ImuState {
            local_from_imu: geometry::Pose::identity(),
            velocity: Vector3::zeros(),
            gyroscope_bias: Vector3::zeros(),
            accelerometer_bias: Vector3::zeros(),
        };
        let config = EstimatorConfig::default();
        let initial = InitialState { stamp_ns: 0, imu, covariance: config.initial.covariance() };
        Health::new(&initial, &config)
    }

    fn image(used: usize, gated: usize, not_triangulated: usize, dropped_observations: usize) -> TrackReport {
        TrackReport { used, not_triangulated, gated, dropped_observations, ..TrackReport::default() }
    }

    fn watched(reports: impl Iterator<Item = TrackReport>) -> Health {
        let mut health = watch();
        for (k, report) in reports.enumerate() {
            health.note_tracks(k as i64 * 100_000_000, &report);
        }
        health
    }

    #[test]
    fn tracks_that_contradict_for_seconds_are_a_divergence_and_a_bad_moment_is_not() {
        let bad = || image(0, 4, 3, 20);
        assert!(watched(std::iter::repeat_n(bad(), 40)).contradicted().is_some());
        let moment = std::iter::repeat_n(image(6, 0, 0, 0), 30).chain(std::iter::repeat_n(bad(), 15));
        let health = watched(moment);
        assert_eq!(health.contradicted(), None);
        assert!(health.is_suspicious(), "a pose of this moment is not to be built on");
        assert_eq!(watched(std::iter::repeat_n(bad(), 25)).contradicted(), None, "not long enough");
        assert_eq!(
            watched(std::iter::repeat_n(image(0, 1, 0, 0), 40)).contradicted(),
            None,
            "too few tracks"
        );
        // No parallax (standing, or far away) is no contradiction.
        assert_eq!(watched(std::iter::repeat_n(image(1, 0, 7, 0), 40)).contradicted(), None);
    }

    #[test]
    fn speeds_and_biases_that_cannot_be_are_named() {
        let health = watch();
        let still = ImuState {
            local_from_imu: geometry::Pose::identity(),
            velocity: Vector3::zeros(),
            gyroscope_bias: Vector3::zeros(),
            accelerometer_bias: Vector3::zeros(),
        };
        assert_eq!(health.implausible(&still, 0), None);
        let fast = ImuState { velocity: Vector3::repeat(70.0), ..still };
        assert!(health.implausible(&fast, 0).unwrap().contains("121 m/s"));
        let biased = ImuState { gyroscope_bias: Vector3::x() * 0.21, ..still };
        assert!(health.implausible(&biased, 0).unwrap().contains("gyroscope"));
        let pushed = ImuState { accelerometer_bias: Vector3::x() * 0.21, ..still };
        assert!(health.implausible(&pushed, 0).unwrap().contains("accelerometer"));
        // A bias may walk: in an hour by 0.18 m/s^2.
        assert_eq!(health.implausible(&pushed, 3_600_000_000_000), None);
    }
}
