//! What a filter knows of the map besides its pose in it, for the next filter of the same robot.

use super::Estimator;
use crate::map_update::map_gravity::MapGravity;
use crate::map_update::map_watch::MapWatch;

/// What a filter has found out about the map in use, which holds on when it diverges.
#[derive(Clone, Debug, Default)]
pub struct MapKnowledge {
    /// Which map it is: answers of another one are refused.
    identity: Option<u128>,
    gravity: MapGravity,
    /// Of a map whose answers contradict odometry, until they have not for a while.
    watch: Option<MapWatch>,
}

impl Estimator {
    /// What is known of the map up to now.
    pub fn map_knowledge(&self) -> MapKnowledge {
        MapKnowledge {
            identity: self.map_version.identity(),
            gravity: self.map_gravity,
            watch: self.map_watch.alarm().map(|_| self.map_watch.clone()),
        }
    }

    /// Continues from what another filter of the same robot knows of the map; before the first answer.
    pub fn resume_map(&mut self, known: &MapKnowledge) {
        if let Some(identity) = known.identity {
            self.map_version.belong_to(identity);
        }
        self.map_gravity = known.gravity;
        if let Some(watch) = &known.watch {
            self.map_watch = watch.clone();
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::propagation::{ImuMatrix, ImuState};
    use crate::{CalibratedCamera, Estimator, EstimatorConfig, InitialState};
    use geometry::Pose;
    use geometry::camera::{Camera, Distortion};
    use nalgebra::Vector3;

    #[test]
    fn the_next_filter_is_in_the_same_map() {
        let (focal, centre) = ([400.0; 2], [320.0, 240.0]);
        let camera = Camera { width: 640, height: 480, focal, centre, distortion: Distortion::None };
        let imu = ImuState::at_rest(Vector3::zeros(), Vector3::zeros());
        let initial = InitialState { stamp_ns: 0, imu, covariance: ImuMatrix::identity() * 1e-4 };
        let filter = || {
            let rig = vec![CalibratedCamera::new(camera.clone(), Pose::identity())];
            Estimator::new(EstimatorConfig::default(), rig, &initial).unwrap()
        };
        let (mut diverged, mut next) = (filter(), filter());
        diverged.map_version.belong_to(7);
        for seen in [Vector3::x(), Vector3::x()] {
            let _ = diverged.map_gravity.compare(Some(Vector3::z()), seen);
        }
        next.resume_map(&diverged.map_knowledge());
        assert_eq!(next.map_identity(), Some(7));
        assert!(next.map_gravity.fault().is_some());
        assert_eq!(next.map_version.in_use(), None, "its keyframes are not held");
    }
}
