//! What map building can be told, what it can fail for, and how it says how far it is.

use nalgebra::Vector3;

/// Settings of [`super::build_map`].
#[derive(Clone, Debug, PartialEq)]
pub struct BuildOptions {
    /// Name of the map, for people.
    pub name: String,
    /// What the map is made from, for people.
    pub created_by: String,
    /// Direction in which gravity points in G (unit vector), where known.
    pub gravity_in_global: Option<Vector3<f64>>,
    /// Only frames from this time on, seconds from the first frame.
    pub from_s: f64,
    /// Only frames up to this time, seconds from the first frame.
    pub until_s: f64,
    /// Replaces the rotation sigma of every reference pose (rad).
    pub sigma_theta_rad: Option<f64>,
    /// Replaces the position sigma of every reference pose (m).
    pub sigma_p_m: Option<f64>,
    /// Standard deviation of a feature's pixel (px); measured from what the refinement leaves where not given.
    pub sigma_px: Option<f64>,
    /// A keyframe is taken when the camera has moved this far from the last one (m), or turned by `min_rotation`.
    ///
    /// Tuned on `walk` (twice the matches of 0.3 m and 10 deg when its start is seen again) and on MH_03 in the map of
    /// MH_01 (0.033 m instead of 0.076 m with one keyframe a query): each keyframe has its own independent pose error.
    pub min_distance: f64,
    /// See `min_distance` (rad).
    pub min_rotation: f64,
    /// A keyframe is taken after half of that already where less than this part of the last one's features is found
    /// again.
    pub min_overlap: f64,
    /// Each keyframe is matched with this many that follow it in time.
    pub time_neighbours: usize,
    /// Each keyframe is matched with this many others that look at the same place from nearby.
    pub space_neighbours: usize,
    /// Largest descriptor distance, in the unit of the descriptors' metric; the metric's default where not given.
    pub max_descriptor_distance: Option<f32>,
    /// Landmarks seen by fewer keyframes than this are dropped, unless one saw them in stereo; at least 2.
    pub min_observations: usize,
    /// Whether poses are refined along with the landmarks while these are located. Off only for comparisons.
    pub refine_poses: bool,
    /// Which poses the map states.
    pub stored_poses: StoredPoses,
}

/// Which poses a map states for its keyframes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum StoredPoses {
    /// Refined by what the images say, with the joint covariance that is left.
    #[default]
    Refined,
    /// As they were given, with independent errors.
    Given,
}

impl Default for BuildOptions {
    fn default() -> Self {
        Self {
            name: "map".to_owned(),
            created_by: "driftless build-map".to_owned(),
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
        }
    }
}

/// Why no map could be built.
#[derive(Debug, thiserror::Error)]
pub enum BuildError {
    /// A setting is impossible.
    #[error("{0}")]
    Options(String),
    /// The recording has no features for place recognition.
    #[error(
        "{sequence} has no mav0/cam0/features.csv, or it is empty, and no extractor was asked for: a map is built from \
         features"
    )]
    NoFeatures {
        /// The recording.
        sequence: String,
    },
    /// The recording has no images.
    #[error("{sequence} has no images in mav0/cam0/data: copy them there, or build from a features.csv")]
    NoImages {
        /// The recording.
        sequence: String,
    },
    /// The extractor failed.
    #[error("{image}: {source}")]
    Extraction {
        /// The file.
        image: String,
        /// What went wrong.
        source: vision::ExtractError,
    },
    /// Features and poses do not meet.
    #[error(
        "no image has both features and a reference pose at its time ({images} images, {poses} poses, {in_time} images \
         between --from and --until; poses at most 0.11 s apart are interpolated): check that both are of one recording"
    )]
    NoCommonStamps {
        /// Images with features.
        images: usize,
        /// Reference poses.
        poses: usize,
        /// Images with features in the stretch of time asked for.
        in_time: usize,
    },
    /// Descriptors cannot be compared.
    #[error("the descriptors cannot be matched: {0}")]
    Descriptors(#[from] vision::DescriptorError),
    /// The joint covariance of the poses cannot be computed.
    #[error(
        "the refined poses have no covariance: are the sigmas of the given poses far too large? --no-refine-poses states the given \
         poses instead"
    )]
    Indefinite,
    /// The result breaks a law of maps.
    #[error("the map that was built is invalid, which is a fault of this program: {0}")]
    Contents(#[from] map::contents::ContentsError),
}

/// A step of map building that can take long.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Selecting keyframes and extracting their features.
    Seeing,
    /// Matching pairs of keyframes.
    Matching,
    /// Finding where the landmarks are, one by one.
    Locating,
    /// Refining all of them, and the poses with them.
    Refining,
    /// Working out how uncertain the poses are, and how their errors depend on each other.
    Weighing,
}

impl Stage {
    /// A word for a progress bar.
    pub fn label(self) -> &'static str {
        match self {
            Self::Seeing => "seeing",
            Self::Matching => "matching",
            Self::Locating => "locating",
            Self::Refining => "refining",
            Self::Weighing => "weighing",
        }
    }
}

/// Told how far a stage is: the stage, steps done, steps in all.
pub type Progress<'a> = &'a mut dyn FnMut(Stage, usize, usize);
