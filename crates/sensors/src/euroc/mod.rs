//! Recordings on disk in the EuRoC ASL layout.

mod camera_folder;
mod folder;
mod stamps;
mod tables;
pub mod writer;

pub(crate) use folder::Folder;
pub use folder::FolderCalibration;
pub use tables::{
    QuaternionLength, pose_cells, pose_of, read_groundtruth, read_reference_poses, read_reference_positions,
};
