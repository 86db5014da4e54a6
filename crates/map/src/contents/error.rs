//! Which invariant of maps is violated, and by which record.

use geometry::covariance_check::CovarianceError;
use geometry::{CameraError, MAX_COORDINATE_M};
use protocol::{KeyframeId, LandmarkId, MAX_EXTRACTOR_BYTES};

use crate::model::MAX_ID;
use crate::sessions::LedgerProblem;

/// An invariant that a map violates.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ContentsError {
    /// What applies to the map as a whole is impossible.
    #[error("map info: {problem}")]
    Metadata {
        /// What is wrong with it.
        problem: MetadataProblem,
    },
    /// A keyframe is impossible.
    #[error("keyframe {id}: {problem}")]
    Keyframe {
        /// Which keyframe.
        id: KeyframeId,
        /// What is wrong with it.
        problem: KeyframeProblem,
    },
    /// A landmark is impossible.
    #[error("landmark {id}: {problem}")]
    Landmark {
        /// Which landmark.
        id: LandmarkId,
        /// What is wrong with it.
        problem: LandmarkProblem,
    },
    /// A cross-covariance is impossible.
    #[error("cross-covariance of keyframes {a} and {b}: {problem}")]
    CrossCovariance {
        /// Keyframe of the rows.
        a: KeyframeId,
        /// Keyframe of the columns.
        b: KeyframeId,
        /// What is wrong with it.
        problem: CrossCovarianceProblem,
    },
    /// A common error is impossible.
    #[error("common error of keyframe {keyframe}: {problem}")]
    CommonError {
        /// Whose error it is.
        keyframe: KeyframeId,
        /// What is wrong with it.
        problem: CommonErrorProblem,
    },
    /// Features of an added kind are impossible.
    #[error("added features {extractor:?}: {problem}")]
    AddedFeatures {
        /// Their extractor.
        extractor: String,
        /// What is wrong with them.
        problem: AddedFeaturesProblem,
    },
    /// The image of a keyframe is impossible.
    #[error("image of keyframe {keyframe}: {problem}")]
    Image {
        /// The keyframe.
        keyframe: KeyframeId,
        /// What is wrong with it.
        problem: ImageProblem,
    },
    /// The aliases of a keyframe are impossible.
    #[error("aliases of keyframe {keyframe}: {problem}")]
    Aliases {
        /// Whose aliases they are.
        keyframe: KeyframeId,
        /// What is wrong with them.
        problem: AliasProblem,
    },
    /// What is known of a landmark's existence is impossible.
    #[error("existence of landmark {landmark}: {problem}")]
    Existence {
        /// Which landmark.
        landmark: LandmarkId,
        /// What is wrong with it.
        problem: ExistenceProblem,
    },
}

/// What can be wrong with [`crate::MapMetadata`].
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MetadataProblem {
    /// Descriptors of zero bytes.
    #[error("descriptors must have at least one byte")]
    EmptyDescriptors,
    /// A float descriptor is no whole number of floats.
    #[error("a float descriptor of {width} bytes is no whole number of f32")]
    FloatWidth {
        /// Bytes in a descriptor.
        width: u16,
    },
    /// The pixel noise is not positive.
    #[error("pixel sigma must be positive, it is {sigma_px}")]
    PixelSigma {
        /// Its value (px).
        sigma_px: f64,
    },
    /// The extractor's name is too long or not printable.
    #[error("the extractor's name must be at most {} bytes without control characters", MAX_EXTRACTOR_BYTES)]
    ExtractorName,
    /// The direction of gravity is no unit vector.
    #[error("gravity must be a unit vector, its length is {norm}")]
    Gravity {
        /// Its length.
        norm: f64,
    },
    /// The ledger of sessions contradicts itself or the map.
    #[error("ledger of sessions: {0}")]
    Sessions(Box<LedgerProblem>),
}

/// What can be wrong with a [`crate::Keyframe`].
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum KeyframeProblem {
    /// The id is too large.
    #[error("its id is larger than {}, which leaves no room for the ids of other maps", MAX_ID)]
    Id,
    /// Two keyframes have this id.
    #[error("the id occurs twice")]
    Duplicate,
    /// The position has an undefined coordinate, or one beyond the bound.
    #[error("its position {position:?} is not finite, or exceeds {MAX_COORDINATE_M:e} m")]
    Position {
        /// Its value (m).
        position: [f64; 3],
    },
    /// The rotation is no unit quaternion.
    #[error("its quaternion has length {norm}, not 1")]
    Quaternion {
        /// Its length.
        norm: f64,
    },
    /// The intrinsics are unusable.
    #[error("its camera is unusable: {0}")]
    Camera(CameraError),
    /// The covariance of the pose is none.
    #[error("its covariance {0}")]
    Covariance(CovarianceError),
    /// Its features have other descriptors than the map.
    #[error("its features have descriptors of another kind or width than the map")]
    DescriptorFormat,
    /// Its features come from another extractor than the map's.
    #[error("its features come from the extractor {found:?}, the map says {expected:?}")]
    Extractor {
        /// The extractor of the features.
        found: String,
        /// The extractor of the map.
        expected: String,
    },
    /// Not every feature has one descriptor.
    #[error("the numbers of its features and of their descriptors differ")]
    DescriptorCount,
    /// A pixel has an infinite or undefined coordinate.
    #[error("a feature's pixel is not finite")]
    FeaturePixel,
}

/// What can be wrong with a [`crate::Landmark`].
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum LandmarkProblem {
    /// The id is too large.
    #[error("its id is larger than {}, which leaves no room for the ids of other maps", MAX_ID)]
    Id,
    /// Two landmarks have this id.
    #[error("the id occurs twice")]
    Duplicate,
    /// The position has an undefined coordinate, or one beyond the bound.
    #[error("its position {position:?} is not finite, or exceeds {MAX_COORDINATE_M:e} m")]
    Position {
        /// Its value (m).
        position: [f64; 3],
    },
    /// An observing keyframe is missing.
    #[error("it is observed by keyframe {keyframe}, which is not in the map")]
    UnknownKeyframe {
        /// The missing keyframe.
        keyframe: KeyframeId,
    },
    /// A pixel is outside the image.
    #[error("its pixel ({}, {}) lies outside the image of keyframe {keyframe}", pixel[0], pixel[1])]
    PixelOutside {
        /// The observing keyframe.
        keyframe: KeyframeId,
        /// Column and row (px).
        pixel: [f64; 2],
    },
    /// A descriptor is not as wide as the map's.
    #[error("its descriptor in keyframe {keyframe} has {found} bytes, the map's have {expected}")]
    DescriptorWidth {
        /// The observing keyframe.
        keyframe: KeyframeId,
        /// Its bytes.
        found: usize,
        /// [`crate::MapMetadata::descriptor_width`].
        expected: u16,
    },
    /// A keyframe observes the landmark twice.
    #[error("keyframe {keyframe} observes it twice")]
    ObservedTwice {
        /// The observing keyframe.
        keyframe: KeyframeId,
    },
    /// The anchor does not observe the landmark.
    #[error("its anchor, keyframe {anchor}, does not observe it")]
    AnchorDoesNotObserve {
        /// The anchor.
        anchor: KeyframeId,
    },
}

/// What can be wrong with a [`crate::KeyframeCrossCovariance`].
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CrossCovarianceProblem {
    /// The pair is listed more than once.
    #[error("the pair occurs twice")]
    Duplicate,
    /// Both keyframes are the same.
    #[error("a keyframe's own covariance belongs into the keyframe")]
    SameKeyframe,
    /// A keyframe of the pair is missing.
    #[error("one of them is not in the map")]
    UnknownKeyframe,
    /// The 12x12 covariance of the pair is none.
    #[error("the joint covariance of the two {0}")]
    JointCovariance(CovarianceError),
}

/// What can be wrong with a [`crate::CommonError`].
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CommonErrorProblem {
    /// The keyframe has more than one.
    #[error("the keyframe occurs twice")]
    Duplicate,
    /// The keyframe is missing.
    #[error("it is not in the map")]
    UnknownKeyframe,
    /// Its factor has not as many columns as those of the others.
    #[error("its factor has {found} columns, that of the first one has {expected}")]
    Columns {
        /// Its columns.
        found: usize,
        /// Those of the first common error.
        expected: usize,
    },
    /// What is left of the keyframe's covariance, or the covariance itself, is none.
    #[error("the keyframe's covariance without it {0}")]
    Remaining(CovarianceError),
}

/// What can be wrong with [`crate::KeyframeAliases`].
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum AliasProblem {
    /// The keyframe has more than one list of them.
    #[error("the keyframe occurs twice")]
    Duplicate,
    /// A keyframe is missing.
    #[error("keyframe {keyframe} is not in the map")]
    UnknownKeyframe {
        /// The one that is missing.
        keyframe: KeyframeId,
    },
    /// The keyframe is its own alias.
    #[error("the keyframe could be taken for itself")]
    Itself,
    /// The log-odds are no number.
    #[error("the log-odds of keyframe {keyframe} are {log_odds}")]
    LogOdds {
        /// The keyframe next to the other place.
        keyframe: KeyframeId,
        /// Its log-odds.
        log_odds: f64,
    },
}

/// What can be wrong with [`crate::AddedFeatures`].
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum AddedFeaturesProblem {
    /// Another kind of the map has the extractor.
    #[error("the map has features of this extractor already")]
    Duplicate,
    /// The extractor has no name.
    #[error("an added kind needs the name of its extractor, by which queries choose it")]
    Unnamed,
    /// What applies to all of them is impossible.
    #[error("{0}")]
    Kind(Box<MetadataProblem>),
    /// An id does not come after those of the kinds before.
    #[error(
        "landmark {id}: its id is not larger than those of the landmarks before it, of this and of former kinds"
    )]
    Order {
        /// The landmark.
        id: LandmarkId,
    },
    /// A landmark is impossible.
    #[error("landmark {id}: {problem}")]
    Landmark {
        /// Which landmark.
        id: LandmarkId,
        /// What is wrong with it.
        problem: LandmarkProblem,
    },
}

/// What can be wrong with a [`crate::KeptImage`].
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ImageProblem {
    /// The keyframe has two images.
    #[error("the keyframe occurs twice")]
    Duplicate,
    /// The keyframe is missing.
    #[error("the keyframe is not in the map")]
    UnknownKeyframe,
    /// The bytes are no JPEG file.
    #[error("it is not a JPEG file")]
    NotJpeg,
}

/// What can be wrong with [`crate::LandmarkExistence`].
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ExistenceProblem {
    /// The landmark has more than one.
    #[error("the landmark occurs twice")]
    Duplicate,
    /// The landmark is missing.
    #[error("the landmark is not in the map")]
    UnknownLandmark,
    /// The log-odds are no number.
    #[error("the log-odds are {log_odds}")]
    LogOdds {
        /// Their value.
        log_odds: f64,
    },
}
