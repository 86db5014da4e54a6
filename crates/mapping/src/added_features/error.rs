//! Why no features could be added.

use map::ContentsError;
use protocol::KeyframeId;

use crate::error::BuildError;

/// Why no features could be added to a map.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum AddFeaturesError {
    /// The map has no images.
    #[error(
        "the map keeps no images of its keyframes, in which features could be computed: build it with `driftless build-map \
         --keep-images`, or build a map of these features with `--extractor`"
    )]
    NoImages,
    /// The map was adjusted by these features.
    #[error("the map was built of the features of {extractor}: there is nothing to add")]
    Primary {
        /// Their extractor.
        extractor: String,
    },
    /// The features were added before.
    #[error("the map has features of {extractor} already: --force computes them again")]
    Present {
        /// Their extractor.
        extractor: String,
    },
    /// An image cannot be read.
    #[error(
        "the image of keyframe {keyframe} cannot be read: {source}; take the images out with `driftless edit-map --drop-images`, and build the map again"
    )]
    Image {
        /// The keyframe.
        keyframe: KeyframeId,
        /// What is wrong.
        source: vision::ImageError,
    },
    /// An image is not of the keyframe's camera.
    #[error("the image of keyframe {keyframe} has {} x {} pixels, its camera {} x {}", found.0, found.1, expected.0, expected.1)]
    ImageSize {
        /// The keyframe.
        keyframe: KeyframeId,
        /// Columns and rows of the image.
        found: (usize, usize),
        /// Columns and rows of the camera.
        expected: (usize, usize),
    },
    /// The extractor failed.
    #[error("the image of keyframe {keyframe}: {source}")]
    Extraction {
        /// The keyframe.
        keyframe: KeyframeId,
        /// What is wrong.
        source: vision::ExtractError,
    },
    /// No landmark was found.
    #[error("none of the features in {images} images agree with each other and with the poses of the map")]
    NothingMatched {
        /// How many images.
        images: usize,
    },
    /// Matching failed.
    #[error(transparent)]
    Matching(#[from] BuildError),
    /// The map with its features is not valid.
    #[error("the map would become invalid: {0}")]
    Invalid(#[from] ContentsError),
}
