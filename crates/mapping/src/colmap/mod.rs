//! Maps from COLMAP models: metric, with descriptors, and with the covariance that the model's residuals say it has.
//!
//! | step | module |
//! |---|---|
//! | unit of length and direction of gravity | `frame` |
//! | descriptors of the points that the images see | `descriptors` |
//! | joint covariance of the poses, from the reprojection errors | `covariance` |
//! | the map is assembled | `import` |

mod covariance;
mod descriptors;
mod frame;
mod import;
#[cfg(test)]
mod tests;

pub use frame::{ColmapFrame, Gravity, stamp_images};
pub use import::{ColmapImport, import_colmap};
