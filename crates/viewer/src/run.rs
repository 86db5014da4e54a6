//! A recorded run as the page draws it.

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
pub struct TrackPoint {
    /// Seconds since the start of the run.
    pub t: f64,
    /// Position, metres.
    pub position: [f64; 3],
    /// Rotation to the parent frame.
    pub rotation_wxyz: [f64; 4],
    /// Covariance of the position, m^2, by rows; of the ground truth zero.
    pub position_covariance: [[f64; 3]; 3],
    /// Error of the position, metres; not finite (null) where the truth is not known.
    pub error_m: Option<[f64; 3]>,
}
