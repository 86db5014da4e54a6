//! Adaptation of the noise levels from the innovations: white noise of the IMU, pixel noise of tracks, of matches.
//!
//! A data sheet states the noise of an IMU at rest; a moving vehicle has 3 to 10 times as much. The noise of tracked and
//! matched pixels depends on images, front end, feature extractor and map. A filter that is told too little becomes
//! overconfident, one that is told too much loses accuracy. The innovations of a consistent filter have the covariance that
//! the filter predicts, so their ratio shows the noise:
//!
//! | noise | innovation | with the expectation |
//! |---|---|---|
//! | tracks | NIS of a track, landmark eliminated, before its gate | its degrees of freedom |
//! | IMU | [`correction`] of rotation and velocity by an image or an answer | `P⁻ - P⁺` |
//! | matches | residuals ([`match_residuals`]) of an answer that no pose explains | the pixel noise |
//!
//! The factor on the noise of the IMU is also not below what differences of its readings show ([`reading_noise`]).
//!
//! Each ratio updates a factor on the stated variance. A track has up to 80 rows and its poses but a few degrees
//! of freedom, so its NIS shows pixel noise mainly; corrections of the state are due to the noise of the IMU mainly. Both
//! factors converge together.
//!
//! Source: Mehra, "Approaches to adaptive filtering", IEEE Transactions on Automatic Control 17(5), 1972 (covariance
//! matching); Myers and Tapley, "Adaptive sequential estimation with unknown noise statistics", IEEE Transactions on
//! Automatic Control 21(4), 1976 (process noise from corrections). Means of ratios are clipped as in Huber's estimator.
//! Recursive quantiles of the same ratios were tried instead of clipped means: the errors of simulated odometry were 2 to 5 %
//! larger, those on real recordings equal.

mod bound;
pub mod correction;
pub mod match_residuals;
pub mod reading_noise;
mod variance_factor;

pub use bound::{NoiseBound, NoiseFault};

use crate::config::{AdaptiveNoise, EstimatorConfig};
use bound::{IMPLAUSIBLE_IMU_SCALE, IMPLAUSIBLE_TRACK_PX, Limit};
use nalgebra::{DMatrix, DVector};
use reading_noise::ReadingNoise;
use serde::{Deserialize, Serialize};
use types::ImuNoise;
use types::ImuSample;
use variance_factor::{Adaptation, VarianceFactor};

/// Number of tracks of one image whose NIS is used: the exact NIS costs time, and these are enough.
pub const TRACKS_PER_IMAGE: usize = 3;

/// Number of matches of one answer with independent errors. Matches with the same keyframes share what pixels cannot show:
/// errors of the calibration, of the keyframe's own triangulation, of the extractor at one scale. With hundreds of matches
/// their mean error, not their noise, limits the accuracy, so the noise of more than these matches is increased in
/// proportion to the root of their number. Two EuRoC flights (60 to 800 matches an answer) have a position NEES of 2.0 to 4
/// without it; simulated runs do not change.
const INDEPENDENT_MATCHES: f64 = 30.0;

/// Mean length of a vector of two normal errors, in standard deviations.
const MEAN_LENGTH: f64 = 1.2533;

const IMU: Adaptation = Adaptation { start: 25.0, floor: 1.0, first_gain: 0.1, last_gain: 0.01 };
const TRACKS: Adaptation = Adaptation { start: 4.0, floor: 0.16, first_gain: 0.1, last_gain: 0.005 };
const MATCHES: Adaptation = Adaptation { start: 4.0, floor: 1.0, first_gain: 1.0, last_gain: 0.1 };

/// Noise in units of the stated one that a sensor shows at least.
const LEAST_SHOWN: f64 = 0.1;

/// Noise levels as learned from the innovations; those that are fixed by the settings are as stated there.
///
/// ```
/// use estimator::{EstimatorConfig, LearnedNoise};
///
/// let mut config = EstimatorConfig::default();
/// config.adaptive_noise.imu = false; // take imu_noise as stated
/// assert_eq!(LearnedNoise::at_start(&config).imu_noise_scale, 1.0);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct LearnedNoise {
    /// Factor on the stated white noise densities of the IMU.
    pub imu_noise_scale: f64,
    /// Standard deviation of tracked pixels, px.
    pub sigma_track_px: f64,
    /// Factor on the stated standard deviations of matched pixels, in the image and in the map.
    pub match_noise_scale: f64,
}

impl LearnedNoise {
    /// Before the first measurement.
    pub fn at_start(config: &EstimatorConfig) -> Self {
        NoiseAdaptation::new(config, None).learned()
    }
}

/// The noise levels of one filter.
#[derive(Clone, Debug)]
pub struct NoiseAdaptation {
    stated_track_px: f64,
    stated_imu: ImuNoise,
    adaptive: AdaptiveNoise,
    imu: VarianceFactor,
    readings: ReadingNoise,
    tracks: VarianceFactor,
    matches: VarianceFactor,
    imu_limit: Limit,
    track_limit: Limit,
}

impl NoiseAdaptation {
    /// At its start; from `learned` on where another filter of the same sensors has learned it already.
    pub fn new(config: &EstimatorConfig, learned: Option<&LearnedNoise>) -> Self {
        let adaptive = config.adaptive_noise;
        let factor = |is_adaptive: bool, adaptation, scale: Option<f64>| match scale {
            _ if !is_adaptive => VarianceFactor::fixed(),
            Some(scale) => VarianceFactor::resumed(adaptation, scale * scale),
            None => VarianceFactor::new(adaptation),
        };
        let stated_track_px = config.sigma_track_px;
        Self {
            stated_track_px,
            stated_imu: config.imu_noise,
            adaptive,
            readings: ReadingNoise::default(),
            imu: factor(adaptive.imu, IMU, learned.map(|learned| learned.imu_noise_scale)),
            tracks: factor(
                adaptive.tracks,
                TRACKS,
                learned.map(|learned| learned.sigma_track_px / stated_track_px),
            ),
            matches: factor(adaptive.matches, MATCHES, learned.map(|learned| learned.match_noise_scale)),
            imu_limit: Limit::new(IMPLAUSIBLE_IMU_SCALE),
            track_limit: Limit::new(IMPLAUSIBLE_TRACK_PX),
        }
    }

    /// The noise levels now.
    pub fn learned(&self) -> LearnedNoise {
        LearnedNoise {
            imu_noise_scale: self.imu.sigma_factor(),
            sigma_track_px: self.sigma_track_px(),
            match_noise_scale: self.matches.sigma_factor(),
        }
    }

    /// Noise of the IMU now, from the stated one.
    pub fn imu_noise(&self, stated: &ImuNoise) -> ImuNoise {
        stated.inflated(self.imu.sigma_factor())
    }

    /// Notes a reading of the IMU: the factor on its noise is not below what the readings show of both sensors.
    pub fn note_reading(&mut self, reading: &ImuSample) {
        self.readings.add(reading);
        let (shown, stated) = (self.readings.shown(), &self.stated_imu);
        let least = (shown.gyroscope / stated.gyroscope).min(shown.accelerometer / stated.accelerometer);
        self.imu.hold_above(least * least);
    }

    /// Whether the readings show noise as a sensor's do, and not those of a simulator without any.
    pub fn do_readings_show_noise(&self) -> bool {
        let (shown, stated) = (self.readings.shown(), &self.stated_imu);
        shown.gyroscope > LEAST_SHOWN * stated.gyroscope
            && shown.accelerometer > LEAST_SHOWN * stated.accelerometer
    }

    /// The noise levels that would be learned below what is allowed.
    pub fn at_bounds(&self) -> impl Iterator<Item = NoiseBound> {
        let imu = self.imu.is_held_up().then(|| NoiseBound::Imu { scale: self.imu.sigma_factor() });
        let tracks = self.tracks.is_held_up().then(|| NoiseBound::Tracks { sigma_px: self.sigma_track_px() });
        imu.into_iter().chain(tracks)
    }

    /// The noise levels that sensors cannot have.
    pub fn faults(&self) -> impl Iterator<Item = NoiseFault> {
        let (scale, sigma_px) = (self.imu.sigma_factor(), self.sigma_track_px());
        let imu = self.imu_limit.is_exceeded().then_some(NoiseFault::Imu { scale });
        let tracks = self.track_limit.is_exceeded().then_some(NoiseFault::Tracks { sigma_px });
        imu.into_iter().chain(tracks)
    }

    /// Noise of a tracked pixel now, px.
    pub fn sigma_track_px(&self) -> f64 {
        self.stated_track_px * self.tracks.sigma_factor()
    }

    /// Notes the NIS of a track for each degree of freedom, at the noise of now.
    pub fn note_track(&mut self, nis_per_row: f64) {
        self.tracks.update(nis_per_row);
        self.track_limit.note(self.sigma_track_px());
    }

    /// Notes a correction of the IMU's state, squared and in units of its expectation.
    pub fn note_correction(&mut self, ratio: f64) {
        self.imu.update(ratio);
        self.imu_limit.note(self.imu.sigma_factor());
    }

    /// The noise of the matches of one answer, before any gate.
    ///
    /// At least that of its own residuals: an answer with more noise than those before is no contradiction.
    ///
    /// # Arguments
    /// * `jacobian`, `residual`: rows of all verified landmarks, whitened by the stated noise.
    /// * `pose_columns`: number of columns of the clone and the transform, which act as one pose.
    /// * `matches`: number of verified landmarks.
    /// * `reprojection`: mean reprojection error at their PnP pose in one keyframe, in units of the stated noise. Residuals
    ///   beyond it are no noise: the keyframes contradict each other or the state.
    pub fn of_matches(
        &self,
        jacobian: &DMatrix<f64>,
        residual: &DVector<f64>,
        pose_columns: usize,
        matches: usize,
        reprojection: f64,
    ) -> MatchNoise {
        let mut learned = self.matches.clone();
        if !self.adaptive.matches {
            return MatchNoise { sigma_factor: learned.sigma_factor(), learned };
        }
        let own = match_residuals::robust_sigma(jacobian, residual, pose_columns)
            .map(|own| own.min(reprojection / MEAN_LENGTH));
        if let Some(own) = own {
            learned.average(own * own);
        }
        let shared = (matches as f64 / INDEPENDENT_MATCHES).max(1.0).sqrt();
        MatchNoise { sigma_factor: learned.sigma_factor().max(own.unwrap_or(0.0)) * shared, learned }
    }

    /// Keeps the noise of an answer that was accepted: a rejected one changes nothing.
    pub fn accept_matches(&mut self, noise: MatchNoise) {
        self.matches = noise.learned;
    }
}

/// The noise of the matches of one answer.
#[derive(Clone, Debug)]
pub struct MatchNoise {
    /// Factor on the stated standard deviations.
    pub sigma_factor: f64,
    learned: VarianceFactor,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_that_no_sensor_has_is_a_fault_until_it_is_clearly_less() {
        let mut noise = NoiseAdaptation::new(&EstimatorConfig::default(), None);
        assert_eq!(noise.faults().count(), 0, "at the start");
        let truth_is = |noise: &mut NoiseAdaptation, scale: f64| {
            for _ in 0..3000 {
                noise.note_correction((scale / noise.learned().imu_noise_scale).powi(2));
            }
        };
        truth_is(&mut noise, 10.0);
        assert_eq!(noise.faults().count(), 0, "a vehicle that vibrates");
        truth_is(&mut noise, 60.0);
        let fault = noise.faults().next().unwrap();
        assert!(matches!(fault, NoiseFault::Imu { scale } if (59.0..61.0).contains(&scale)), "{fault}");
        truth_is(&mut noise, 16.0);
        assert_eq!(noise.faults().count(), 1, "not clearly less");
        truth_is(&mut noise, 12.0);
        assert_eq!(noise.faults().count(), 0);
        (0..3000).for_each(|_| noise.note_track(1e3));
        assert!(matches!(noise.faults().next(), Some(NoiseFault::Tracks { .. })));
    }
}
