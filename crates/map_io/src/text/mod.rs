//! Maps as plain text, so that other programs can write and read them.
//!
//! # Files
//! | file | a line |
//! |---|---|
//! | `keyframes.csv` | id, time (ns), pose of the camera in G (m, Hamilton quaternion, w first), isotropic sigmas of its error `[δθ, δp]` (rad, m) |
//! | `landmarks.csv` | id, anchor keyframe, position in the anchor's camera frame (m) |
//! | `observations.csv` | landmark, keyframe, pixel, descriptor in hexadecimal digits |
//! | `camera.yaml` | resolution, intrinsics and distortion as in a `sensor.yaml` of the EuRoC layout |
//!
//! Further files hold what these cannot express; they are written only where they are needed:
//! | file | content |
//! |---|---|
//! | `map.yaml` | name, origin, direction of gravity in G, kind of the descriptors, sigma of the map's pixels |
//! | `covariances.csv` | keyframe, 6x6 covariance of `[δθ, δp]` in G by rows: replaces the two sigmas |
//! | `cross_covariances.csv` | two keyframes, 6x6 block `E[e_a e_bᵀ]` by rows, without what `common_errors.csv` says |
//! | `common_errors.csv` | keyframe, 6xN factor `U` by columns: adds `U_a U_bᵀ` to the covariance of any two keyframes |
//! | `aliases.csv` | keyframe, and another one that its image could be taken for with its log-odds; a keyframe alone has none |
//! | `existence.csv` | landmark, log-odds that it is there, time of these, time at which it was seen last (ns) |
//! | `sessions.json` | the ledger: which recordings the map was made of, as `manifest.json` of a stored map has it |
//! | `features.csv` | keyframe, pixel, descriptor: all features of an image, also those without a landmark |
//! | `camera_1.yaml` ... | further cameras; `keyframes.csv` then has a column with the camera's number |
//!
//! Reading a written map gives an equal map, and writing a map that was read gives the same numbers.
//!
//! # Example
//! ```
//! use map_io::text::{read_map, write_map};
//! use map::{MapContents, MapMetadata};
//! use protocol::DescriptorKind;
//!
//! let folder = tempfile::tempdir()?;
//! let contents = MapContents::empty(MapMetadata::new("hall", "example", DescriptorKind::Binary, 32));
//! write_map(folder.path(), &contents)?;
//! assert_eq!(read_map(folder.path())?, contents);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod camera_yaml;
mod error;
mod features;
mod info_yaml;
mod read;
mod sessions;
mod table;
#[cfg(test)]
mod tests;
mod write;

pub use camera_yaml::read_camera;
pub use error::MapFileError;
pub use features::read_image_features;
pub use read::read_map;
pub use write::write_map;

/// File names.
mod names {
    pub(super) const KEYFRAMES: &str = "keyframes.csv";
    pub(super) const LANDMARKS: &str = "landmarks.csv";
    pub(super) const OBSERVATIONS: &str = "observations.csv";
    pub(super) const CAMERA: &str = "camera.yaml";
    pub(super) const INFO: &str = "map.yaml";
    pub(super) const COVARIANCES: &str = "covariances.csv";
    pub(super) const CROSS_COVARIANCES: &str = "cross_covariances.csv";
    pub(super) const COMMON_ERRORS: &str = "common_errors.csv";
    pub(super) const ALIASES: &str = "aliases.csv";
    pub(super) const EXISTENCE: &str = "existence.csv";
    pub(super) const FEATURES: &str = "features.csv";
    pub(super) const SESSIONS: &str = "sessions.json";
    /// All of them.
    pub(super) const ALL: [&str; 12] = [
        KEYFRAMES,
        LANDMARKS,
        OBSERVATIONS,
        CAMERA,
        INFO,
        COVARIANCES,
        CROSS_COVARIANCES,
        COMMON_ERRORS,
        ALIASES,
        EXISTENCE,
        FEATURES,
        SESSIONS,
    ];

    /// The file of one of several cameras.
    pub(super) fn camera(index: u32) -> String {
        if index == 0 { CAMERA.to_owned() } else { format!("camera_{index}.yaml") }
    }
}

/// First lines of the tables.
mod columns {
    pub(super) const KEYFRAMES: &str = "id,timestamp [ns],p_x [m],p_y [m],p_z [m],q_w,q_x,q_y,q_z,\
                                        sigma_theta [rad],sigma_p [m]";
    pub(super) const LANDMARKS: &str = "id,anchor_keyframe,x [m],y [m],z [m]";
    pub(super) const OBSERVATIONS: &str = "landmark,keyframe,u [px],v [px],descriptor [hex]";
    pub(super) const COVARIANCES: &str = "keyframe,36 entries of the 6x6 covariance by rows";
    pub(super) const CROSS_COVARIANCES: &str = "keyframe_a,keyframe_b,36 entries of the 6x6 block by rows";
    pub(super) const COMMON_ERRORS: &str = "keyframe,6 entries of each column of its factor";
    pub(super) const ALIASES: &str = "keyframe,other keyframe,log-odds";
    pub(super) const EXISTENCE: &str = "landmark,log-odds,timestamp [ns],last seen [ns]";
    pub(super) const FEATURES: &str = "keyframe,u [px],v [px],descriptor [hex]";
}
