//! Cameras that send one image again and again.

use super::image::LiveImage;

/// A camera is frozen where its image has not changed for so long, nanoseconds. Real images differ by their noise.
const FROZEN_NS: i64 = 1_000_000_000;

/// An image beside the one before.
#[derive(Debug)]
pub(super) enum Compared {
    /// It differs.
    New,
    /// It is the same.
    Same,
    /// It has been the same for so many seconds: the camera is frozen.
    Frozen(f64),
}

/// The newest image of a camera that differed from the one before.
#[derive(Debug, Default)]
pub(super) struct Repetition {
    image: Option<(i64, LiveImage)>,
}

impl Repetition {
    /// Compares an image with the one before.
    pub(super) fn check(&mut self, stamp_ns: i64, image: &LiveImage) -> Compared {
        match &self.image {
            Some((since_ns, before)) if before == image => {
                let lasted_ns = stamp_ns.saturating_sub(*since_ns);
                if lasted_ns < FROZEN_NS { Compared::Same } else { Compared::Frozen(lasted_ns as f64 * 1e-9) }
            }
            _ => {
                self.image = Some((stamp_ns, image.clone()));
                Compared::New
            }
        }
    }
}
