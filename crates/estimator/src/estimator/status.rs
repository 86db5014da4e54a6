//! Localization status.

use super::Estimator;
use crate::gnss::watch::GnssFault;
use crate::imu::repetition::ImuFault;
use crate::map_update::map_fix::worst_sigmas;
use crate::map_update::map_gravity::GravityFault;
use crate::map_update::map_initializer::Waiting;
use crate::map_update::map_watch::MapDrift;
use crate::noise_adaptation::{NoiseBound, NoiseFault};
use crate::wheels::watch::WheelFault;
use serde::{Deserialize, Serialize};

/// Whether the pose in G can be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Localization {
    /// Odometry works; there is no pose in the map yet that is known well enough, or no map.
    OdometryOnly,
    /// There is a pose in the map.
    Localized,
    /// There was a pose in the map, or odometry, that cannot be trusted any more.
    Lost,
    /// There is no pose yet, and none was lost: the first initialization goes on.
    Starting,
}

impl Localization {
    /// Whether there is a pose, in G or of odometry, that can be used.
    pub fn is_usable(self) -> bool {
        matches!(self, Self::OdometryOnly | Self::Localized)
    }
}

/// Reason of a [`Localization`].
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum StatusReason {
    /// The map corrected the pose.
    #[error("the map corrected the pose {seconds_ago:.1} s ago")]
    MapUpdate {
        /// Time since the last map update, seconds.
        seconds_ago: f64,
    },
    /// GNSS corrected the pose, and the map did not since.
    #[error("GNSS corrected the pose {seconds_ago:.1} s ago")]
    GnssUpdate {
        /// Time since then, seconds.
        seconds_ago: f64,
    },
    /// The map contradicted the pose, and `global_from_local` was removed.
    #[error("the map contradicted the pose {rejections} times in a row")]
    Contradicted {
        /// Number of consecutive rejected answers.
        rejections: usize,
    },
    /// The map has not corrected the pose yet.
    #[error("no match with the map yet")]
    NoMatchYet,
    /// The map corrected the pose, but it is not known well enough yet to be given out.
    #[error("the pose in the map is known to {sigma_m:.2} m; {needed_m} m are needed")]
    Uncertain {
        /// Standard deviation of the position along its worst axis, metres.
        sigma_m: f64,
        /// [`EstimatorConfig::localized_sigma_m`](crate::EstimatorConfig::localized_sigma_m).
        needed_m: f64,
    },
    /// Answers of the map may be of a picture that repeats.
    #[error("{0}")]
    NotDistinctive(Waiting),
}

/// What must be wrong although the filter goes on: with the map, or with the sensors.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Alarm {
    /// Its direction of gravity.
    #[error(transparent)]
    Gravity(#[from] GravityFault),
    /// Its answers move against odometry.
    #[error(transparent)]
    Drift(#[from] MapDrift),
    /// What sensors show contradicts their calibration.
    #[error(transparent)]
    Noise(#[from] NoiseFault),
    /// The IMU does not measure.
    #[error(transparent)]
    Imu(#[from] ImuFault),
    /// The wheels contradict cameras and IMU, or are silent.
    #[error(transparent)]
    Wheels(#[from] WheelFault),
    /// GNSS contradicts the pose.
    #[error(transparent)]
    Gnss(#[from] GnssFault),
}

/// [`Localization`] and its reason.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// Whether the pose in G can be used.
    pub localization: Localization,
    /// The reason as text.
    pub reason: String,
    /// Time of the state at the last map update, nanoseconds.
    pub last_map_update_ns: Option<i64>,
    /// Number of held keyframes.
    pub held_keyframes: usize,
}

impl Estimator {
    /// The localization status.
    pub fn status(&self) -> Status {
        let (localization, reason) = self.localization();
        let mut reason = reason.to_string();
        for alarm in self.alarms() {
            reason = format!("{reason}; {alarm}");
        }
        for bound in self.noise_at_bounds() {
            reason = format!("{reason}; {bound}");
        }
        Status {
            localization,
            reason,
            last_map_update_ns: self.last_map_update_ns,
            held_keyframes: self.covariance.held.len(),
        }
    }

    /// The localization status with its reason as a type.
    pub fn localization(&self) -> (Localization, StatusReason) {
        if let (Some(_), Some(rejections)) = (&self.state.transform, self.is_contradicted()) {
            return (Localization::Lost, StatusReason::Contradicted { rejections });
        }
        let seconds_ago = |last_ns: i64| (self.state.stamp_ns - last_ns) as f64 * 1e-9;
        let last = self.last_map_update_ns.max(self.last_gnss_update_ns);
        match (&self.state.transform, self.lost_after, last) {
            (Some(_), _, Some(_)) if !self.known_in_map => {
                let (sigma_m, needed_m) = (self.sigma_in_map(), self.config.localized_sigma_m);
                (Localization::OdometryOnly, StatusReason::Uncertain { sigma_m, needed_m })
            }
            (Some(_), _, Some(last_ns)) if self.last_map_update_ns == Some(last_ns) => {
                let seconds_ago = seconds_ago(last_ns);
                (Localization::Localized, StatusReason::MapUpdate { seconds_ago })
            }
            (Some(_), _, Some(last_ns)) => {
                let seconds_ago = seconds_ago(last_ns);
                (Localization::Localized, StatusReason::GnssUpdate { seconds_ago })
            }
            (_, Some(rejections), _) => (Localization::Lost, StatusReason::Contradicted { rejections }),
            _ => {
                let reason = self
                    .map_initializer
                    .waiting()
                    .map_or(StatusReason::NoMatchYet, StatusReason::NotDistinctive);
                (Localization::OdometryOnly, reason)
            }
        }
    }

    /// Standard deviation of the position in G along its worst axis by the answers, metres, whatever the watch over the map says of
    /// them; infinite without one.
    fn sigma_in_map(&self) -> f64 {
        self.sigmas_in_map().1
    }

    /// Standard deviations of the pose in G about and along the worst axes: rad, metres; infinite without one.
    pub(super) fn sigmas_in_map(&self) -> (f64, f64) {
        let global = self.filtered_global_from_imu();
        global.map_or((f64::INFINITY, f64::INFINITY), |global| worst_sigmas(&global.covariance))
    }

    /// From the first answer on after which the position is known within
    /// [`EstimatorConfig::localized_sigma_m`](crate::EstimatorConfig::localized_sigma_m), the robot is localized.
    pub(super) fn note_known(&mut self) {
        self.known_in_map = self.known_in_map || self.sigma_in_map() <= self.config.localized_sigma_m;
    }

    /// What contradicts the map or the sensors, and what to do about it.
    pub fn alarms(&self) -> Vec<Alarm> {
        let gravity = self.map_gravity.fault().map(Alarm::from);
        let drift = self.map_watch.alarm().map(Alarm::from);
        let wheels = self.wheels.as_ref().and_then(|wheels| wheels.watch.fault()).map(Alarm::from);
        let gnss = self.gnss.as_ref().and_then(|gnss| gnss.watch.fault()).map(Alarm::from);
        let of_noise = self.noise.faults().map(Alarm::from);
        let imu = self.repetition.fault().map(Alarm::from);
        imu.into_iter().chain(gravity).chain(drift).chain(of_noise).chain(wheels).chain(gnss).collect()
    }

    /// Noise levels that the innovations would move below what is allowed: the covariance may be too large.
    pub fn noise_at_bounds(&self) -> Vec<NoiseBound> {
        self.noise.at_bounds().collect()
    }

    /// Counts a verified answer that the gates rejected. After too many in a row that show more different places than support
    /// the state, it is wrong, and `global_from_local` is removed.
    pub(super) fn note_contradiction(&mut self) {
        if self.state.transform.is_none() {
            return;
        }
        self.rejections_in_a_row += 1;
        if let Some(fix) = self.newest_fix {
            self.against.add(fix.seen);
        }
        if self.rejections_in_a_row >= self.config.lost_after_rejections
            && self.is_outweighed_by(self.against.log_odds())
        {
            self.lost_after = Some(self.rejections_in_a_row);
            self.rejections_in_a_row = 0;
            (self.last_map_update_ns, self.last_gnss_update_ns) = (None, None);
            self.refute_transform();
        }
    }
}
