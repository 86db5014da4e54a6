//! Divergence checks.
//!
//! A diverged filter keeps a small covariance while its gates reject the measurements that would reveal the error. So
//! these checks look for what cannot occur in a consistent filter: tracks that contradict the state for seconds,
//! implausible speeds and biases, and an unbounded velocity.

use crate::config::EstimatorConfig;
use crate::covariance::JointCovariance;
use crate::initialization::static_init::InitialState;
use crate::odometry::msckf_update::TrackReport;
use crate::propagation::{ACCELEROMETER_BIAS, GYROSCOPE_BIAS, ImuState, VELOCITY};
use crate::state::ActiveState;
use nalgebra::Vector3;
use std::collections::VecDeque;

/// Time over which tracks must contradict the state, nanoseconds. A real flight (`v202`) has 1.5 s in which nearly all
/// tracks are gated, and recovers.
const CONTRADICTED_NS: i64 = 3_000_000_000;
/// Minimum number of finished tracks in that time.
const MIN_TRACKS: usize = 40;
/// Fraction of tracks that agree, below which the state is wrong. Good runs stay above 0.8 over three seconds on
/// simulated tracks and above 0.17 on real ones; wrong initializations, extrinsics that are off by 30 degrees and random
/// tracks fall below 0.06.
const MIN_AGREEMENT: f64 = 0.10;
/// The same over the newest second, below which the pose is suspicious.
const SUSPICIOUS_AGREEMENT: f64 = 0.5;
/// Time over which tracks that contradict the state show that odometry failed, nanoseconds: a jump contradicts the tracks that
/// it interrupts, and those that begin after it agree again.
const FAILURE_NS: i64 = 300_000_000;
/// Minimum number of finished tracks in that time.
const MIN_FAILED_TRACKS: usize = 10;
/// Time without a track that agrees, after which odometry is the IMU's alone, nanoseconds.
const UNSUPPORTED_NS: i64 = 1_000_000_000;
/// Maximum plausible speed, m/s.
const MAX_SPEED: f64 = 100.0;
/// Maximum deviation of a bias from its initial estimate, in standard deviations (random walk included).
const BIAS_SIGMAS: f64 = 10.0;
/// Maximum standard deviation of the velocity, m/s. A run with an image every few seconds, corrected by the map alone,
/// reaches 1 to 2.
const MAX_VELOCITY_SIGMA: f64 = 10.0;

/// Why the estimate is wrong.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Divergence {
    /// A state is NaN or infinite.
    #[error("a state is not finite")]
    NotFinite,
    /// A variance is negative or NaN.
    #[error("a variance is negative")]
    NegativeVariance,
    /// A covariance could not be factorized.
    #[error("the covariance is not positive definite")]
    CovarianceNotPositiveDefinite,
    /// The velocity is not observed any more.
    #[error("velocity sigma {sigma:.1} m/s exceeds {limit:.1}: was tracking lost?")]
    VelocityUnknown {
        /// Largest standard deviation of the velocity, m/s.
        sigma: f64,
        /// The largest that is accepted, m/s.
        limit: f64,
    },
    /// The IMU was silent for too long.
    #[error("there are no IMU readings for {seconds:.1} s: the motion in between is not known")]
    MotionUnknown {
        /// Length of the gap, seconds.
        seconds: f64,
    },
    /// The speed is implausible.
    #[error("speed {speed:.0} m/s exceeds {limit:.0}")]
    Speed {
        /// Estimated speed, m/s.
        speed: f64,
        /// The largest that is accepted, m/s.
        limit: f64,
    },
    /// The gyroscope bias is too far from its initial estimate.
    #[error("gyroscope bias {bias:.2} rad/s is more than {BIAS_SIGMAS:.0} sigmas from its initial estimate")]
    GyroscopeBias {
        /// Magnitude of the estimated bias, rad/s.
        bias: f64,
    },
    /// The accelerometer bias is too far from its initial estimate.
    #[error(
        "accelerometer bias {bias:.2} m/s^2 is more than {BIAS_SIGMAS:.0} sigmas from its initial estimate"
    )]
    AccelerometerBias {
        /// Magnitude of the estimated bias, m/s^2.
        bias: f64,
    },
    /// Most tracks contradict the state.
    #[error("{percent:.0} % of {tracks} tracks contradict the state for {seconds:.1} s")]
    TracksContradict {
        /// Percentage of the tracks that contradict the state.
        percent: f64,
        /// Finished tracks.
        tracks: usize,
        /// Time over which they do, seconds.
        seconds: f64,
    },
}

/// Track counts of one image.
#[derive(Clone, Copy, Debug)]
struct Counts {
    stamp_ns: i64,
    agreed: usize,
    finished: usize,
    dropped: usize,
    /// Something in the image supports the motion.
    is_supported: bool,
}

/// An initial bias with the variances of its components.
#[derive(Clone, Copy, Debug)]
struct InitialBias {
    bias: Vector3<f64>,
    variances: Vector3<f64>,
    /// Random walk density.
    walk: f64,
}

impl InitialBias {
    fn new(bias: Vector3<f64>, initial: &InitialState, begin: usize, walk: f64) -> Self {
        let variances = initial.covariance.diagonal().fixed_rows::<3>(begin).into_owned();
        Self { bias, variances, walk }
    }

    fn is_far(&self, value: &Vector3<f64>, seconds: f64) -> bool {
        let limit = |variance: f64| BIAS_SIGMAS * (variance + self.walk * self.walk * seconds).sqrt();
        (0..3).any(|k| (value[k] - self.bias[k]).abs() > limit(self.variances[k]))
    }
}

/// Divergence checks of one filter since its initialization.
#[derive(Clone, Debug)]
pub struct Health {
    start_ns: i64,
    gyroscope_bias: InitialBias,
    accelerometer_bias: InitialBias,
    images: VecDeque<Counts>,
}

impl Health {
    /// Checks of a filter that starts from `initial`.
    pub fn new(initial: &InitialState, config: &EstimatorConfig) -> Self {
        let (imu, noise) = (&initial.imu, &config.imu_noise);
        Self {
            start_ns: initial.stamp_ns,
            gyroscope_bias: InitialBias::new(
                imu.gyroscope_bias,
                initial,
                GYROSCOPE_BIAS,
                noise.gyroscope_walk,
            ),
            accelerometer_bias: InitialBias::new(
                imu.accelerometer_bias,
                initial,
                ACCELEROMETER_BIAS,
                noise.accelerometer_walk,
            ),
            images: VecDeque::new(),
        }
    }

    /// Records the track counts of an image.
    pub fn note_tracks(&mut self, stamp_ns: i64, report: &TrackReport) {
        self.images.push_back(Counts {
            stamp_ns,
            agreed: report.used + report.slam_features,
            finished: report.used
                + report.gated
                + report.not_triangulated
                + report.slam_features
                + report.slam_features_gated,
            dropped: report.gated + report.slam_features_gated + report.dropped_observations,
            is_supported: report.stationary || report.used + report.slam_features > 0,
        });
        // One image older than the time span is kept, so that the images cover all of it.
        while self.images.get(1).is_some_and(|second| stamp_ns - second.stamp_ns >= CONTRADICTED_NS) {
            self.images.pop_front();
        }
    }

    /// Whether there is a sign that odometry failed a moment ago: most tracks contradict the state, or none supports it.
    pub fn has_odometry_failed(&self, stamp_ns: i64) -> bool {
        let supported = self.images.iter().rev().find(|image| image.is_supported);
        let supported_ns = supported.map_or(self.start_ns, |image| image.stamp_ns);
        if stamp_ns - supported_ns > UNSUPPORTED_NS {
            return true;
        }
        let newest_ns = self.images.back().map_or(0, |image| image.stamp_ns);
        let newest = self.images.iter().filter(|image| newest_ns - image.stamp_ns < FAILURE_NS);
        agreement(newest).is_some_and(|(fraction, finished)| {
            finished >= MIN_FAILED_TRACKS && fraction < SUSPICIOUS_AGREEMENT
        })
    }

    /// Whether most tracks of the newest second contradict the state.
    pub fn is_suspicious(&self) -> bool {
        let newest_ns = self.images.back().map_or(0, |image| image.stamp_ns);
        let newest = self.images.iter().filter(|image| newest_ns - image.stamp_ns < CONTRADICTED_NS / 3);
        agreement(newest).is_some_and(|(fraction, _)| fraction < SUSPICIOUS_AGREEMENT)
    }

    /// Checks state, covariance and the recorded tracks.
    ///
    /// # Errors
    /// [`Divergence`] is the first check that fails.
    pub fn check(&self, state: &ActiveState, covariance: &JointCovariance) -> Result<(), Divergence> {
        if !state.is_finite() {
            return Err(Divergence::NotFinite);
        }
        let variance = |k: usize| covariance.active()[(k, k)];
        if (0..state.dim()).any(|k| variance(k).is_nan() || variance(k) < 0.0) {
            return Err(Divergence::NegativeVariance);
        }
        let sigma = velocity_variance(&state.imu.velocity, covariance).sqrt();
        if sigma > MAX_VELOCITY_SIGMA {
            return Err(Divergence::VelocityUnknown { sigma, limit: MAX_VELOCITY_SIGMA });
        }
        self.check_imu(&state.imu, state.stamp_ns)?;
        self.check_tracks()
    }

    /// Speed and biases.
    fn check_imu(&self, imu: &ImuState, stamp_ns: i64) -> Result<(), Divergence> {
        let speed = imu.velocity.norm();
        if speed > MAX_SPEED {
            return Err(Divergence::Speed { speed, limit: MAX_SPEED });
        }
        let seconds = (stamp_ns - self.start_ns) as f64 * 1e-9;
        if self.gyroscope_bias.is_far(&imu.gyroscope_bias, seconds) {
            return Err(Divergence::GyroscopeBias { bias: imu.gyroscope_bias.norm() });
        }
        if self.accelerometer_bias.is_far(&imu.accelerometer_bias, seconds) {
            return Err(Divergence::AccelerometerBias { bias: imu.accelerometer_bias.norm() });
        }
        Ok(())
    }

    /// Tracks that contradict the state over the whole time span.
    fn check_tracks(&self) -> Result<(), Divergence> {
        let (Some(first), Some(last)) = (self.images.front(), self.images.back()) else { return Ok(()) };
        let Some((fraction, tracks)) = agreement(self.images.iter()) else { return Ok(()) };
        let span_ns = last.stamp_ns - first.stamp_ns;
        if span_ns >= CONTRADICTED_NS && tracks >= MIN_TRACKS && fraction < MIN_AGREEMENT {
            let (percent, seconds) = (100.0 * (1.0 - fraction), span_ns as f64 * 1e-9);
            return Err(Divergence::TracksContradict { percent, tracks, seconds });
        }
        Ok(())
    }
}

/// The largest variance of the velocity along an axis of L (m^2/s^2) but for the part that is the yaw's: where that is unknown, so is the direction
/// of a velocity that the body knows.
fn velocity_variance(velocity: &Vector3<f64>, covariance: &JointCovariance) -> f64 {
    const YAW: usize = 2;
    let turned = Vector3::z().cross(velocity);
    let active = covariance.active();
    let along = |k: usize| {
        let (own, with_yaw) = (active[(VELOCITY + k, VELOCITY + k)], active[(VELOCITY + k, YAW)]);
        own - 2.0 * turned[k] * with_yaw + turned[k].powi(2) * active[(YAW, YAW)]
    };
    (0..3).map(along).fold(0.0, f64::max)
}

/// Fraction of the tracks that agree with the state, and how many were tested; `None` without any.
///
/// A track that cannot be triangulated contradicts the state if its outlying observations were dropped in vain, and is
/// uninformative if it has no parallax. Reports do not tell the two apart, so the larger of both fractions is returned.
fn agreement<'a>(images: impl Iterator<Item = &'a Counts>) -> Option<(f64, usize)> {
    let (mut agreed, mut finished, mut dropped) = (0, 0, 0);
    for image in images {
        agreed += image.agreed;
        finished += image.finished;
        dropped += image.dropped;
    }
    let fraction = |of: usize| agreed as f64 / of as f64;
    let tested = finished.min(agreed + dropped);
    (tested > 0).then(|| (fraction(finished).max(fraction(agreed + dropped)), tested))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn health() -> Health {
        let imu = ImuState {
            local_from_imu: geometry::Pose::identity(),
            velocity: Vector3::zeros(),
            gyroscope_bias: Vector3::zeros(),
            accelerometer_bias: Vector3::zeros(),
        };
        let mut config = EstimatorConfig::default();
        config.initial = config.initial.with_known_biases();
        let initial = InitialState { stamp_ns: 0, imu, covariance: config.initial.covariance() };
        Health::new(&initial, &config)
    }

    fn image(used: usize, gated: usize, not_triangulated: usize, dropped_observations: usize) -> TrackReport {
        TrackReport { used, not_triangulated, gated, dropped_observations, ..TrackReport::default() }
    }

    fn health_after(reports: impl Iterator<Item = TrackReport>) -> Health {
        let mut health = health();
        for (k, report) in reports.enumerate() {
            health.note_tracks(k as i64 * 100_000_000, &report);
        }
        health
    }

    #[test]
    fn tracks_that_contradict_for_seconds_are_a_divergence_and_shorter_ones_are_not() {
        let bad = || image(0, 4, 3, 20);
        assert!(health_after(std::iter::repeat_n(bad(), 40)).check_tracks().is_err());
        let moment = std::iter::repeat_n(image(6, 0, 0, 0), 30).chain(std::iter::repeat_n(bad(), 15));
        let health = health_after(moment);
        assert_eq!(health.check_tracks(), Ok(()));
        assert!(health.is_suspicious(), "the pose at this time is suspicious");
        assert_eq!(health_after(std::iter::repeat_n(bad(), 25)).check_tracks(), Ok(()), "not long enough");
        assert_eq!(
            health_after(std::iter::repeat_n(image(0, 1, 0, 0), 40)).check_tracks(),
            Ok(()),
            "too few tracks"
        );
        // No parallax (stationary, or distant features) is no contradiction.
        assert_eq!(health_after(std::iter::repeat_n(image(1, 0, 7, 0), 40)).check_tracks(), Ok(()));
        let nothing_tested = health_after(std::iter::repeat_n(image(0, 0, 8, 0), 40));
        assert_eq!(nothing_tested.check_tracks(), Ok(()));
        assert!(!nothing_tested.is_suspicious());
    }

    /// A vehicle at 12 m/s whose heading nobody knows after two seconds without readings.
    #[test]
    fn a_velocity_that_is_uncertain_with_the_yaw_only_is_known() {
        let velocity = Vector3::new(12.0, 1.0, 0.2);
        let mut by_yaw = nalgebra::DVector::zeros(15);
        by_yaw[2] = 1.0;
        by_yaw.rows_mut(VELOCITY, 3).copy_from(&Vector3::z().cross(&velocity));
        let known = nalgebra::DMatrix::identity(15, 15) * 0.01;
        let of = |covariance| velocity_variance(&velocity, &JointCovariance::new(covariance, 4)).sqrt();
        let turned = of(&known + &by_yaw * by_yaw.transpose() * 3.0);
        assert!(turned < 2.0, "{turned}");
        by_yaw[2] = 0.0;
        assert!(of(known + &by_yaw * by_yaw.transpose() * 3.0) > MAX_VELOCITY_SIGMA);
    }

    #[test]
    fn implausible_speeds_and_biases_are_divergences() {
        let health = health();
        let still = ImuState {
            local_from_imu: geometry::Pose::identity(),
            velocity: Vector3::zeros(),
            gyroscope_bias: Vector3::zeros(),
            accelerometer_bias: Vector3::zeros(),
        };
        assert_eq!(health.check_imu(&still, 0), Ok(()));
        let fast = ImuState { velocity: Vector3::repeat(70.0), ..still };
        assert!(health.check_imu(&fast, 0).unwrap_err().to_string().contains("121 m/s"));
        let biased = ImuState { gyroscope_bias: Vector3::x() * 0.21, ..still };
        assert!(health.check_imu(&biased, 0).unwrap_err().to_string().contains("gyroscope"));
        let pushed = ImuState { accelerometer_bias: Vector3::x() * 0.21, ..still };
        assert!(health.check_imu(&pushed, 0).unwrap_err().to_string().contains("accelerometer"));
        // Random walk of a bias: 0.18 m/s^2 in an hour.
        assert_eq!(health.check_imu(&pushed, 3_600_000_000_000), Ok(()));
    }
}
