//! Updates by GNSS.

use super::Estimator;
use crate::error::EstimatorError;
use crate::gnss::alignment::{Located, Unaligned, align, extents};
use crate::gnss::measurement::{Between, GnssMeasurement, antenna_in_local};
use crate::gnss::report::GnssCounts;
use crate::gnss::{BadGnssReading, Gnss};
use geometry::PoseWithCovariance;
use types::GnssReading;

/// A map that corrected the pose within this time supports the state against GNSS, nanoseconds.
const MAP_SUPPORTS_NS: i64 = 60_000_000_000;

impl Estimator {
    /// Stores a position of GNSS for the next [`Self::time_update`]. Readings come in the order of time, and are used at the first
    /// image behind them. Without [`EstimatorConfig::gnss`](crate::EstimatorConfig::gnss) it does nothing.
    ///
    /// # Errors
    /// [`BadGnssReading`]: the reading was dropped; the filter goes on.
    pub fn gnss(&mut self, reading: GnssReading) -> Result<(), BadGnssReading> {
        self.gnss.as_mut().map_or(Ok(()), |gnss| gnss.push(reading))
    }

    /// What GNSS did; `None` without it.
    pub fn gnss_counts(&self) -> Option<GnssCounts> {
        self.gnss.as_ref().map(|gnss| gnss.counts)
    }

    /// How GNSS corrected [`Self::local_from_imu`] in the last [`Self::time_update`]: before and after, at one time. `None` where it
    /// did not.
    pub fn gnss_correction(&self) -> Option<[PoseWithCovariance; 2]> {
        self.gnss.as_ref()?.correction
    }

    /// Takes in the newest clone, and makes the updates that are due.
    pub(super) fn gnss_updates(&mut self) -> Result<(), EstimatorError> {
        let Some(mut gnss) = self.gnss.take() else { return Ok(()) };
        if let Some(newest) = self.state.clones.last() {
            gnss.add_clone(newest.id, self.state.stamp_ns);
        }
        let (before, used) = (self.local_from_imu(), gnss.counts.used);
        let mut done = Ok(());
        while let (Ok(()), Some((reading, between))) = (&done, gnss.next_due(&self.state)) {
            done = self.gnss_update(&mut gnss, &reading, &between);
        }
        gnss.correction = (gnss.counts.used > used).then(|| [before, self.local_from_imu()]);
        self.gnss = Some(gnss);
        done
    }

    /// Tests one reading and uses it, or what it initializes.
    fn gnss_update(
        &mut self,
        gnss: &mut Gnss,
        reading: &GnssReading,
        between: &Between,
    ) -> Result<(), EstimatorError> {
        let antenna = gnss.config.antenna();
        let Some(in_local) = antenna_in_local(&self.state, between, &antenna) else { return Ok(()) };
        gnss.locate(Located {
            stamp_ns: reading.stamp_ns,
            in_local,
            in_global: reading.position,
            covariance: reading.covariance,
        });
        let Some(transform) = self.state.transform else {
            gnss.counts.before_initialization += 1;
            self.initialize_by_gnss(gnss, i64::MIN);
            return Ok(());
        };
        let first = self.config.first_estimates;
        let Some(measurement) =
            GnssMeasurement::new(&self.state, between, &antenna, &reading.position, first)
        else {
            return Ok(());
        };
        let is_accepted = measurement.whiten(&reading.covariance, &mut gnss.rows)
            && gnss.gate.accepts(self.covariance.nis(&gnss.rows)?, gnss.rows.residual.len());
        let apart_m = (reading.position - transform.transform(&in_local)).norm();
        let is_trusted = gnss.watch.is_trusted();
        gnss.watch.note(reading.stamp_ns, is_accepted, &in_local, apart_m);
        gnss.counts.left_out += usize::from(!is_trusted);
        gnss.counts.gated += usize::from(is_trusted && !is_accepted);
        if is_trusted && is_accepted {
            let covariance = gnss.inflated(reading);
            if measurement.whiten(&covariance, &mut gnss.rows) {
                self.covariance.measurement_update(&gnss.rows, &mut self.correction)?;
                self.state.retract(&self.correction);
                gnss.counts.used += 1;
                gnss.last_used_ns = Some(reading.stamp_ns);
                self.last_gnss_update_ns = Some(self.state.stamp_ns);
            }
        }
        let is_supported =
            self.last_map_update_ns.is_some_and(|last_ns| self.state.stamp_ns - last_ns < MAP_SUPPORTS_NS);
        if let Some(since_ns) = gnss.watch.long_since_ns().filter(|_| !is_supported) {
            self.initialize_by_gnss(gnss, since_ns);
        }
        Ok(())
    }

    /// Forgets what `global_from_local` could be aligned with: it is about an L, or a transform, that holds no longer.
    pub(super) fn forget_located(&mut self) {
        if let Some(gnss) = &mut self.gnss {
            gnss.located.clear();
        }
    }

    /// Initializes `global_from_local` by the readings since a time, where they fit odometry and show the yaw.
    pub(super) fn initialize_by_gnss(&mut self, gnss: &mut Gnss, since_ns: i64) {
        let begin = gnss.located.partition_point(|located| located.stamp_ns < since_ns);
        let located = &gnss.located.make_contiguous()[begin..];
        let config = &gnss.config;
        let local_now = self.local_from_imu();
        let found = align(located, config.correlation_time_s, config.sigma_tilt_rad, &local_now);
        if let (Err(Unaligned::Misfit), None, [first, .., last]) = (&found, &self.state.transform, located) {
            gnss.watch.note_unaligned(last.stamp_ns - first.stamp_ns, extents(located));
        }
        let Some(found) = found.ok().filter(|found| found.sigma_yaw_rad <= config.initial_sigma_yaw_rad)
        else {
            return;
        };
        self.remove_transform();
        self.insert_transform(&found.transform);
        // What the map said was about another transform.
        self.support.clear();
        self.against.clear();
        self.map_fixes.clear();
        self.contradiction = None;
        self.rejections_in_a_row = 0;
        // Along the way, not from one view: what its covariance says is to be believed.
        self.known_in_map = true;
        self.lost_after = None;
        self.last_gnss_update_ns = Some(self.state.stamp_ns);
        gnss.last_used_ns = gnss.located.back().map(|last| last.stamp_ns);
        gnss.watch.clear();
        gnss.counts.initializations += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::CalibratedCamera;
    use crate::config::{EstimatorConfig, InitialSigmas};
    use crate::gnss::config::GnssConfig;
    use crate::initialization::static_init::InitialState;
    use geometry::{Camera, Distortion, Pose};
    use nalgebra::{Matrix3, Matrix6, Vector3};
    use types::ImuSample;

    const IMAGE_NS: i64 = 100_000_000;

    /// A body at rest whose `global_from_local` is known to a centimetre.
    fn estimator() -> Estimator {
        let distortion = Distortion::None;
        let camera =
            Camera { width: 640, height: 480, focal: [400.0; 2], centre: [320.0, 240.0], distortion };
        let cameras = vec![CalibratedCamera::new(camera, Pose::identity())];
        let (rest, down) = (Vector3::zeros(), -Vector3::z());
        let start = InitialState::from_truth(0, &Pose::identity(), &rest, &down, InitialSigmas::default());
        let config = EstimatorConfig { gnss: Some(GnssConfig::default()), ..EstimatorConfig::default() };
        let mut estimator = Estimator::new(config, cameras, &start).unwrap();
        let transform = PoseWithCovariance::new(Pose::identity(), Matrix6::identity() * 1e-4);
        estimator.insert_transform(&transform);
        for step in 0..=60 {
            let accelerometer = Vector3::z() * estimator.config().gravity;
            let (stamp_ns, gyroscope) = (step * 5_000_000, Vector3::zeros());
            estimator.imu(ImuSample { stamp_ns, gyroscope, accelerometer }).unwrap();
        }
        estimator
    }

    #[test]
    fn a_correction_by_gnss_is_given_out_for_the_image_that_it_was_made_at() {
        let mut estimator = estimator();
        estimator.time_update(IMAGE_NS).unwrap();
        assert_eq!(estimator.gnss_correction(), None);
        let position = Vector3::new(0.02, 0.0, 0.0);
        let covariance = Matrix3::identity() * 1e-4;
        estimator.gnss(GnssReading { stamp_ns: 3 * IMAGE_NS / 2, position, covariance }).unwrap();
        estimator.time_update(2 * IMAGE_NS).unwrap();
        assert_eq!(estimator.gnss_counts().map(|counts| counts.used), Some(1));
        let [before, after] = estimator.gnss_correction().unwrap();
        assert_ne!(before.pose, after.pose);
        assert_eq!(after, estimator.local_from_imu());
        estimator.time_update(3 * IMAGE_NS).unwrap();
        assert_eq!(estimator.gnss_correction(), None);
    }
}
