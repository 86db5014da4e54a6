//! A recorded run as the page draws it.

use crate::viewed_map::{position_covariance, rotation_wxyz};
use geometry::PoseWithCovariance;
use serde::Serialize;

/// The tracks of a run.
#[derive(Clone, Debug, Serialize)]
pub struct RunTracks {
    /// Its name.
    pub name: String,
    /// The pose in G.
    pub global: Vec<TrackPoint>,
    /// The odometry in L.
    pub local: Vec<TrackPoint>,
    /// The odometry frame in G, `G_T_L`.
    pub global_from_local: Vec<TrackPoint>,
    /// The ground truth in G; empty where it is not known.
    pub truth: Vec<TrackPoint>,
    /// The queries: seconds since the start, and whether the answer was used.
    pub queries: Vec<(f64, bool)>,
    /// Upwards in G, a unit vector.
    pub up: [f64; 3],
}

/// A pose of a track.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct TrackPoint {
    /// Seconds since the start of the run.
    pub t: f64,
    /// Position, metres.
    pub position: [f64; 3],
    /// Rotation to the parent frame.
    pub rotation_wxyz: [f64; 4],
    /// Covariance of the position, m^2, by rows; of the ground truth zero.
    pub position_covariance: [[f64; 3]; 3],
    /// Error of the position, metres; `None` where the truth is not known.
    pub error_m: Option<[f64; 3]>,
}

impl TrackPoint {
    /// A pose at a time.
    ///
    /// # Arguments
    /// * `t`: seconds since the start of the run.
    /// * `error_m`: error of the position, metres, where the truth is known.
    pub fn new(t: f64, pose: &PoseWithCovariance, error_m: Option<[f64; 3]>) -> Self {
        Self {
            t,
            position: pose.pose.translation.into(),
            rotation_wxyz: rotation_wxyz(&pose.pose),
            position_covariance: position_covariance(pose),
            error_m,
        }
    }
}
