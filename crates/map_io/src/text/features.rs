//! The features of one image from a sequence's `features.csv`.

use std::path::Path;

use protocol::{DescriptorFormat, DescriptorKind, FeatureSet};

use super::error::MapFileError;
use super::table::Table;

const COLUMNS: &str = "timestamp [ns],u [px],v [px],descriptor [hex]";

/// Reads the features of one image.
///
/// # Arguments
/// * `stamp_ns`: which image; the first one of the file where not given.
/// * `kind`: kind of the descriptors, which the file does not state.
///
/// # Returns
/// The image's time stamp (ns) and its features.
///
/// # Errors
/// [`MapFileError`] for a file that cannot be read, a bad line, or an image that is not in the file.
pub fn read_image_features(
    path: &Path,
    stamp_ns: Option<i64>,
    kind: DescriptorKind,
) -> Result<(i64, FeatureSet), MapFileError> {
    let table = Table::read(path, "give a features.csv, as in mav0/cam0 of a sequence")?;
    let mut wanted = stamp_ns;
    let mut features = FeatureSet::empty(DescriptorFormat { kind, width: 0 });
    for row in table.rows() {
        row.expect_fields(4, 4, COLUMNS)?;
        let stamp: i64 = row.integer(0, "timestamp")?;
        if stamp != *wanted.get_or_insert(stamp) {
            continue;
        }
        let descriptor = row.bytes(3, "descriptor")?;
        if features.pixels.is_empty() {
            features.descriptors.width = u16::try_from(descriptor.len())
                .map_err(|_| row.error("the descriptor is too long", "use at most 65535 bytes"))?;
        }
        if descriptor.len() != usize::from(features.descriptors.width) {
            return Err(row.error(
                format!(
                    "the descriptor has {} bytes, those before {}",
                    descriptor.len(),
                    features.descriptors.width
                ),
                "a short last line means a truncated file",
            ));
        }
        features.pixels.push([row.single(1, "u")?, row.single(2, "v")?]);
        features.descriptors.bytes.extend(descriptor);
    }
    match wanted {
        Some(stamp) if !features.pixels.is_empty() => Ok((stamp, features)),
        Some(stamp) => Err(MapFileError::file(
            path,
            format!("there is no image of time stamp {stamp}"),
            "choose a stamp of the first column, or leave --stamp out for the first image",
        )),
        None => Err(MapFileError::file(path, "it holds no features", format!("its lines are: {COLUMNS}"))),
    }
}
