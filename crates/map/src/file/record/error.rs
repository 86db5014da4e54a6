//! What can be wrong with a record.

/// Why a record cannot be read or written.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RecordError {
    /// The record is shorter than its header.
    #[error("it has only {bytes} bytes")]
    TooShort {
        /// Its length.
        bytes: usize,
    },
    /// The bytes have changed since they were written, or belong to another key.
    #[error("its checksum does not match")]
    Checksum,
    /// The record was written by another version of this program.
    #[error("it has record version {found}, this program reads {expected}")]
    Version {
        /// The version of the record.
        found: u8,
        /// The version that is read.
        expected: u8,
    },
    /// The payload does not have the layout of its version.
    #[error("it cannot be decoded: {reason}")]
    Undecodable {
        /// The message of the decoder.
        reason: String,
    },
    /// The record cannot be written.
    #[error("it cannot be encoded: {reason}")]
    Unencodable {
        /// The message of the encoder.
        reason: String,
    },
    /// The rotation of a keyframe is no unit quaternion.
    #[error("its quaternion has length {norm}")]
    Quaternion {
        /// Its length.
        norm: f64,
    },
    /// The camera of a keyframe has a distortion model that this program does not know.
    #[error("its camera has an unknown distortion model {model}")]
    DistortionModel {
        /// The stored number.
        model: u8,
    },
    /// The camera of a keyframe has another number of coefficients than its distortion model.
    #[error("its camera has {count} coefficients, which its distortion model {model} does not")]
    DistortionCoefficients {
        /// The stored number of the model.
        model: u8,
        /// How many there are.
        count: usize,
    },
    /// Descriptors of a kind that this program does not know.
    #[error("unknown descriptor kind {kind}")]
    DescriptorKind {
        /// The stored number.
        kind: u8,
    },
}
