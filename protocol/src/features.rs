//! The features of one image, pixels and descriptors: what a message may hold of them.

use crate::limits::{MAX_EXTRACTOR_BYTES, MAX_FEATURES, MAX_QUERY_FEATURES};
use crate::validate::{InvalidField, Validate, require, require_valid};

pub use types::{DescriptorFormat, DescriptorKind, Descriptors, FeatureSet};

impl Validate for DescriptorFormat {
    fn validate(&self) -> Result<(), InvalidField> {
        require(self.width > 0, "width", "is zero")?;
        let whole_floats = self.kind != DescriptorKind::Float || self.width.is_multiple_of(4);
        require(whole_floats, "width", "is not a multiple of 4, which a float descriptor's bytes must be")
    }
}

impl Validate for Descriptors {
    fn validate(&self) -> Result<(), InvalidField> {
        self.format().validate()?;
        let whole = self.bytes.len().is_multiple_of(usize::from(self.width));
        require(
            whole,
            "bytes",
            &format!("holds {} bytes, not a multiple of {}", self.bytes.len(), self.width),
        )?;
        if self.kind == DescriptorKind::Float {
            let finite =
                self.bytes.as_chunks::<4>().0.iter().all(|&number| f32::from_le_bytes(number).is_finite());
            require(finite, "bytes", "holds a float that is not finite")?;
        }
        Ok(())
    }
}

/// Checks the name of an extractor: at most [`MAX_EXTRACTOR_BYTES`], no control characters.
pub(crate) fn validate_extractor(name: &str) -> Result<(), InvalidField> {
    let reason = format!("is longer than {MAX_EXTRACTOR_BYTES} bytes");
    require(name.len() <= MAX_EXTRACTOR_BYTES, "extractor", &reason)?;
    require(!name.chars().any(char::is_control), "extractor", "holds a control character")
}

impl Validate for FeatureSet {
    fn validate(&self) -> Result<(), InvalidField> {
        let count = self.pixels.len();
        require(
            count <= MAX_FEATURES,
            "pixels",
            &format!("holds {count} features, more than {MAX_FEATURES}"),
        )?;
        if let Some(index) = self.pixels.iter().position(|pixel| !pixel.iter().all(|value| value.is_finite()))
        {
            return Err(InvalidField::new(format!("pixels[{index}]"), "is not finite"));
        }
        require_valid(&self.descriptors, "descriptors")?;
        validate_extractor(&self.extractor)?;
        let described = self.descriptors.len();
        require(
            described == count,
            "descriptors",
            &format!("holds {described} descriptors for {count} pixels"),
        )
    }
}

/// Checks the features of a query: at most [`MAX_QUERY_FEATURES`].
pub(crate) fn require_query(features: &FeatureSet) -> Result<(), InvalidField> {
    let count = features.len();
    let few = count <= MAX_QUERY_FEATURES;
    let reason = format!("holds {count} features, more than the {MAX_QUERY_FEATURES} of a query");
    require(few, "features.pixels", &reason)?;
    require_valid(features, "features")
}
