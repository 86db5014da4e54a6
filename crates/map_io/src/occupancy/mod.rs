//! A map of keyframes as an occupancy grid, for planners in the plane such as Nav2.
//!
//! | module | what |
//! |---|---|
//! | [`grid`] | [`OccupancyGrid`]: cells that are free, occupied or unknown |
//! | `projection` | [`OccupancyGrid::of_map`]: landmarks between two heights are obstacles, what cameras looked through is free |
//! | `nav2` | [`OccupancyGrid::write_nav2`]: `map.yaml` and `map.pgm` of Nav2's map server |

pub mod error;
pub mod grid;
mod nav2;
mod projection;
mod traversal;

pub use error::GridError;
pub use grid::{Cell, OccupancyGrid};
pub use nav2::{NAV2_IMAGE, NAV2_YAML};
pub use projection::{Floor, GridSettings};

#[cfg(test)]
mod tests;
