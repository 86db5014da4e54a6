//! Offline map building from a recording: images or their features, and poses with known uncertainty or odometry.
//!
//! | step | module |
//! |---|---|
//! | images become keyframes as the camera moves | `keyframe_selection`, `reference_poses` |
//! | features are read, or extracted and matched in stereo | `feature_source`, `stereo_matching` |
//! | both on another thread while odometry gives the poses | `selected_keyframes` |
//! | with reference poses: gravity by the recording's IMU; poses that turn or accelerate otherwise are refused | `reference_gravity`, `gyroscope_check`, `accelerometer_check`, `reading_steps` |
//! | neighbouring keyframes are matched, with the epipolar constraint | `matching` |
//! | matches are joined into tracks | `tracks` |
//! | each track is triangulated with the reference poses and their covariances | `triangulation` |
//! | without reference poses, images too far apart to track points: their poses | `stereo_registration`, `imu_alignment` |
//! | without reference poses: places seen again | `loop_closure` |
//! | all landmarks and poses are refined, with the reference poses as priors or with the IMU | `refinement`, `readings`, crate `adjustment` |
//! | the joint covariance of the refined poses | `joint_covariance` |
//! | the map is assembled | `assemble` |
//! | places that look alike | `aliasing` |
//! | images of keyframes are kept | `kept_images` |
//! | features of a further kind, in images that were kept | `added_features`, `correlations` |
//! | without reference poses: refused where parts are not tied together | `pieces` |
//! | poses and positions that are known besides the recording | `pose_priors` |
//! | a map that exists is extended by another recording | `extension`, `stored_poses`, `stored_landmarks` |
//! | ... in the part of a large map that it shows | `parts` |
//! | a map is moved into another frame | `map_frame` |
//! | two maps of one place are merged | `merging`, `stored_poses`, `stored_landmarks` |
//!
//! [`build_map`] runs them all (`pipeline`); [`build_map_from_odometry`] without reference poses (`without_references`);
//! [`extend_map`] adds a recording to a map; [`import_colmap`] takes poses and points from a COLMAP model instead
//! (`colmap`). The map states the refined poses, each with its covariance and its
//! cross-covariances with other keyframes, so that a robot can weight keyframes whose errors are correlated.
//! With [`StoredPoses::Given`] it states the reference poses instead, whose errors are independent. Landmarks come from the
//! refinement either way, in their anchors' camera frames; the estimator uses them as linearization points only, beside the
//! raw pixels.
//!
//! The example `build_map` simulates a recording and maps it:
//! `cargo run --release -p driftless-mapping --example build_map`.
#![cfg_attr(test, allow(clippy::unwrap_used))]

mod accelerometer_check;
mod added_features;
mod aliasing;
mod assemble;
mod camera;
mod colmap;
mod correlations;
mod error;
mod extension;
mod feature_source;
mod gyroscope_check;
mod imu_alignment;
mod joint_covariance;
mod kept_images;
mod keyframe_selection;
mod keyframe_view;
mod loop_closure;
mod map_frame;
mod matching;
mod merging;
mod odometry;
mod options;
mod parts;
mod pieces;
mod pipeline;
mod places;
mod pose_priors;
mod progress;
mod reading_steps;
mod readings;
mod recorded_odometry;
mod reference_gravity;
mod reference_poses;
mod refinement;
mod report;
mod selected_keyframes;
mod session;
mod stereo_matching;
mod stereo_registration;
mod still_views;
mod stored_landmarks;
mod stored_poses;
#[cfg(test)]
mod tests;
mod tied_keyframes;
mod tracks;
mod triangulation;
mod without_references;

pub use added_features::{AddFeaturesError, AddOptions, AddedReport, add_features};
pub use aliasing::{find_aliases, find_aliases_of_independent};
pub use colmap::{ColmapFrame, ColmapImport, Gravity, import_colmap, stamp_images};
pub use error::BuildError;
pub use extension::{ExtendError, ExtensionReport, extend_map, extend_part};
pub use feature_source::Extraction;
pub use kept_images::{KeptImages, keep_images};
pub use map_frame::map_in_frame;
pub use merging::{MergeError, MergeReport, merge_maps};
pub use odometry::Odometry;
pub use options::{BuildOptions, MapPoses, StoredPoses};
pub use parts::{Former, LocatedErrors, PartShown, located_errors, part_shown, put_back};
pub use pipeline::build_map;
pub use places::SearchedMap;
pub use pose_priors::PosePriors;
pub use progress::{Progress, Stage};
pub use recorded_odometry::{
    OdometryError, OdometryRun, is_sparse, odometry_config, run_configured, run_odometry, run_watched,
};
pub use refinement::MAX_SIGMA_PX;
pub use report::{BuildReport, Spread, UntrackedImages};
pub use selected_keyframes::{SelectedKeyframes, select_during};
pub use session::check_new_recording;
pub use stereo_registration::register_stereo_images;
pub use without_references::build_map_from_odometry;
