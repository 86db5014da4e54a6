//! Why a map has no occupancy grid.

use thiserror::Error;

/// Why a map has no occupancy grid.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum GridError {
    /// A setting that is no length, or lengths in the wrong order.
    #[error("{setting} is {value}; {wanted}")]
    Setting {
        /// Which one.
        setting: &'static str,
        /// What was given, in metres.
        value: f64,
        /// What is possible.
        wanted: &'static str,
    },
    /// The z axis of the map is not vertical.
    #[error(
        "the z axis of the map is {tilt_deg:.1} degrees off the vertical: a grid in its x-y plane would not be of the floor; build the \
         map from reference poses with z up, or without any"
    )]
    NotLevel {
        /// Angle between z and the vertical, degrees.
        tilt_deg: f64,
    },
    /// No landmark lies between the heights, and no camera looked through the space between them.
    #[error(
        "nothing of the map is between {low_m:.2} and {high_m:.2} m of its z axis, where {landmarks} landmarks are from {lowest_m:.2} to \
         {highest_m:.2} m: give other heights, or another floor"
    )]
    Empty {
        /// The lower height in the map's frame, metres.
        low_m: f64,
        /// The upper height, metres.
        high_m: f64,
        /// Landmarks of the map.
        landmarks: usize,
        /// z of the lowest, metres.
        lowest_m: f64,
        /// z of the highest, metres.
        highest_m: f64,
    },
    /// The grid would not fit into memory and messages.
    #[error(
        "a grid of {width} x {height} cells is too large, at most {most} are possible: give a larger resolution, or a shorter range"
    )]
    TooLarge {
        /// Cells along x.
        width: u64,
        /// Cells along y.
        height: u64,
        /// The largest number of cells.
        most: u64,
    },
}
