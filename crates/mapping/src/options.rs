//! Settings of map building.

use map::sessions::Recorded;
use nalgebra::Vector3;

/// Pixel noise (px) that is assumed until it is estimated.
pub(super) const FIRST_SIGMA_PX: f64 = 1.0;

/// Settings of [`super::build_map`].
///
/// # Example
/// ```
/// let mut options = mapping::BuildOptions::default();
/// options.name = "hall".to_owned();
/// options.sigma_px = None; // estimated from the residuals
/// ```
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct BuildOptions {
    /// Name of the map, for display.
    pub name: String,
    /// The program and input that the map is built with, for display.
    pub created_by: String,
    /// The robot that made the recording, where known: for the ledger of sessions.
    pub robot: Option<String>,
    /// What identifies the recording, where it states that itself: a session that a robot handed in. Else it is computed of the
    /// readings and images that are used.
    pub recorded: Option<Recorded>,
    /// Direction in which gravity points in G (unit vector), where known; else, with reference poses, the recording's IMU tells it.
    pub gravity_in_global: Option<Vector3<f64>>,
    /// Only frames from this time on, seconds from the first frame.
    pub from_s: f64,
    /// Only frames up to this time, seconds from the first frame.
    pub until_s: f64,
    /// Replaces the rotation sigma of every reference pose (rad).
    pub sigma_theta_rad: Option<f64>,
    /// Replaces the position sigma of every reference pose (m).
    pub sigma_p_m: Option<f64>,
    /// Standard deviation of a feature's pixel (px); estimated from the residuals of
    /// bundle adjustment where not given.
    pub sigma_px: Option<f64>,
    /// A keyframe is taken when the camera has moved this far from the last one (m), or turned by `min_rotation`.
    ///
    /// Tuned on `walk` (twice the matches of 0.3 m and 10 deg when it returns to its start) and on MH_03 in the map of
    /// MH_01 (0.033 m instead of 0.076 m with one keyframe a query): each keyframe has its own independent pose error.
    pub min_distance: f64,
    /// See `min_distance` (rad).
    pub min_rotation: f64,
    /// A keyframe is taken after half of that motion where less than this part of the last one's features is matched.
    pub min_overlap: f64,
    /// Each keyframe is matched with this many that follow it in time.
    pub time_neighbours: usize,
    /// Each keyframe is matched with this many others that have a similar pose.
    pub space_neighbours: usize,
    /// Largest descriptor distance, in the unit of the descriptors' metric; the metric's default where not given.
    pub max_descriptor_distance: Option<f32>,
    /// Landmarks observed by fewer keyframes than this are dropped, unless one observes them in stereo; at least 2.
    pub min_observations: usize,
    /// Whether poses are estimated together with the landmarks. Off only for comparisons.
    pub refine_poses: bool,
    /// Which poses the map states.
    pub stored_poses: StoredPoses,
    /// What an extension does to the poses that the map had before.
    pub map_poses: MapPoses,
}

/// What an extension does to the poses that a map had before.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum MapPoses {
    /// They are adjusted together with those of the recording. All that the recording observes then has to stay in the map: what is
    /// taken out is used, and would be used again.
    #[default]
    Adjusted,
    /// They stay as they are, with their covariance, and the recording is located in them. Any part of it can be taken out again.
    ///
    /// Source: the consider states of Schmidt 1966.
    Considered,
}

/// Which poses a map states for its keyframes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum StoredPoses {
    /// Refined by bundle adjustment, with their joint covariance.
    #[default]
    Refined,
    /// The reference poses, with independent errors.
    Given,
}

impl Default for BuildOptions {
    fn default() -> Self {
        Self {
            name: "map".to_owned(),
            created_by: "driftless build-map".to_owned(),
            robot: None,
            recorded: None,
            gravity_in_global: None,
            from_s: 0.0,
            until_s: f64::INFINITY,
            sigma_theta_rad: None,
            sigma_p_m: None,
            sigma_px: Some(1.0),
            min_distance: 0.2,
            min_rotation: 5.0_f64.to_radians(),
            min_overlap: 0.3,
            time_neighbours: 10,
            space_neighbours: 10,
            max_descriptor_distance: None,
            min_observations: 2,
            refine_poses: true,
            stored_poses: StoredPoses::Refined,
            map_poses: MapPoses::Adjusted,
        }
    }
}
