//! The whole system on simulated input.
//!
//! | module | what |
//! |---|---|
//! | [`flight`] | from pixels: two flights through a rendered room, a map of the first without reference poses |
//! | [`towns`] | from tracks: several towns with surveyed maps, and the variants of the paper's table |
//! | [`rows`] | the rows of the tables, [`figures`] what they hold |
//! | `robot` | one run of one variant |

pub mod figures;
pub mod flight;
mod robot;
pub mod rows;
pub mod towns;

use nalgebra::Vector3;
pub use robot::Variant;

/// What made the maps of the demo, as they state it: another one in their place is not replaced.
const CREATED_BY: &str = "driftless demo";

/// Direction of gravity in the simulated worlds, which is that of the maps' frames too.
const GRAVITY_IN_GLOBAL: Vector3<f64> = Vector3::new(0.0, 0.0, -1.0);
