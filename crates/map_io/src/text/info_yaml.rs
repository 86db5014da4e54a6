//! `map.yaml`: what applies to the map as a whole, written only where it differs from the defaults.

use std::fmt::Write as _;
use std::path::Path;

use calibration::numbers::{list, shortest};
use map::model::{DEFAULT_SIGMA_PX, MapMetadata};
use nalgebra::Vector3;
use protocol::DescriptorKind;
use serde::Deserialize;

use super::error::MapFileError;

/// Name of a map whose files state none.
const DEFAULT_NAME: &str = "map";
/// Origin of a map whose files state none.
const DEFAULT_ORIGIN: &str = "driftless import-map";

/// The file's content; everything is optional.
#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct InfoYaml {
    name: Option<String>,
    created_by: Option<String>,
    gravity_in_global: Option<[f64; 3]>,
    own_frame: Option<bool>,
    descriptor_kind: Option<String>,
    descriptor_width: Option<u16>,
    #[serde(alias = "pixel_sigma")]
    sigma_px: Option<f64>,
    extractor: Option<String>,
}

impl InfoYaml {
    /// Reads `map.yaml`; a missing file states nothing.
    pub(super) fn read(path: &Path) -> Result<InfoYaml, MapFileError> {
        let text = match files::read_to_string(path) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(InfoYaml::default()),
            Err(reason) => {
                let remedy = "make it readable, or remove it".to_owned();
                return Err(MapFileError::Read { path: path.to_owned(), reason, remedy });
            }
        };
        serde_saphyr::from_str(&text).map_err(|error| {
            MapFileError::file(
                path,
                error.to_string(),
                "its optional keys are name, created_by, gravity_in_global, own_frame, descriptor_kind, \
                 descriptor_width, sigma_px and extractor",
            )
        })
    }

    /// The descriptors' width, if stated (bytes).
    pub(super) fn descriptor_width(&self) -> Option<u16> {
        self.descriptor_width
    }

    /// The map's info, with the width that the observations have where the file states none.
    pub(super) fn into_info(self, path: &Path, width: u16) -> Result<MapMetadata, MapFileError> {
        let label = self.descriptor_kind.as_deref().unwrap_or(DescriptorKind::Binary.label());
        let Some(kind) = DescriptorKind::from_label(label) else {
            let problem = format!("descriptor_kind is {label:?}");
            return Err(MapFileError::file(path, problem, "write binary, float or int8"));
        };
        let mut info = MapMetadata::new(
            self.name.unwrap_or_else(|| DEFAULT_NAME.to_owned()),
            self.created_by.unwrap_or_else(|| DEFAULT_ORIGIN.to_owned()),
            kind,
            width,
        );
        info.gravity_in_global = self.gravity_in_global.map(Vector3::from);
        info.own_frame = self.own_frame.unwrap_or_default();
        info.sigma_px = self.sigma_px.unwrap_or(DEFAULT_SIGMA_PX);
        info.extractor = self.extractor.unwrap_or_default();
        Ok(info)
    }
}

/// The text of `map.yaml`, or `None` where a map without the file means the same.
///
/// The version is not written: it belongs to a database, which counts its own changes.
///
/// # Arguments
/// * `observed_width`: width of the map's descriptors as the observations show it, `None` without observations.
pub(super) fn info_text(info: &MapMetadata, observed_width: Option<u16>) -> Option<String> {
    let mut text = String::new();
    // Writing to a String cannot fail. JSON strings are YAML strings.
    if info.name != DEFAULT_NAME {
        let _ = writeln!(text, "name: {}", serde_json::Value::from(info.name.as_str()));
    }
    if info.created_by != DEFAULT_ORIGIN {
        let _ = writeln!(text, "created_by: {}", serde_json::Value::from(info.created_by.as_str()));
    }
    if let Some(gravity) = info.gravity_in_global {
        let _ = writeln!(text, "gravity_in_global: [{}]", list(gravity.as_slice()));
    }
    if info.own_frame {
        let _ = writeln!(text, "own_frame: true");
    }
    if info.descriptor_kind != DescriptorKind::Binary {
        let _ = writeln!(text, "descriptor_kind: {}", info.descriptor_kind.label());
    }
    if observed_width != Some(info.descriptor_width) {
        let _ = writeln!(text, "descriptor_width: {}", info.descriptor_width);
    }
    if info.sigma_px.to_bits() != DEFAULT_SIGMA_PX.to_bits() {
        let _ = writeln!(text, "sigma_px: {}", shortest(info.sigma_px));
    }
    if !info.extractor.is_empty() {
        let _ = writeln!(text, "extractor: {}", serde_json::Value::from(info.extractor.as_str()));
    }
    (!text.is_empty()).then_some(text)
}
