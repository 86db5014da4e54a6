//! Reading a plain-text map.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use geometry::camera::Camera;
use geometry::pose::Pose;
use geometry::uncertain_pose::{PoseWithCovariance, isotropic_covariance};
use map::contents::MapContents;
use map::model::{
    Alias, CommonError, Keyframe, KeyframeAliases, KeyframeCrossCovariance, Landmark, LandmarkExistence,
    Observation,
};
use nalgebra::{Matrix6, Matrix6xX, Quaternion, Unit, Vector3};
use protocol::{DescriptorFormat, DescriptorKind, FeatureSet, KeyframeId, LandmarkId};

use super::camera_yaml::read_camera;
use super::error::MapFileError;
use super::info_yaml::InfoYaml;
use super::sessions::read_sessions;
use super::table::{Row, Table};
use super::{columns, names};

/// A quaternion whose squared norm is this near to 1 is taken as written, so that what was read can be written
/// again unchanged: nine decimals leave 2e-9.
const UNIT_AS_WRITTEN: f64 = 1e-8;
/// A quaternion further from unit norm than this is a mistake, not rounding.
const UNIT_AT_ALL: f64 = 1e-3;

/// Reads a map from a folder of text files, see [`crate::text`]. The result passes [`MapContents::validate`] and is
/// sorted.
///
/// # Errors
/// [`MapFileError`] naming the file, the line and what to do.
pub fn read_map(folder: &Path) -> Result<MapContents, MapFileError> {
    let info_path = folder.join(names::INFO);
    let info = InfoYaml::read(&info_path)?;
    let mut keyframes = read_keyframes(folder)?;
    read_covariances(folder, &mut keyframes)?;
    let mut landmarks = read_landmarks(folder, &keyframes)?;
    let mut width = info.descriptor_width();
    read_observations(folder, &keyframes, &mut landmarks, &mut width)?;
    let Some(width) = width else {
        return Err(MapFileError::file(
            &folder.join(names::OBSERVATIONS),
            "the map has no observations, so the width of its descriptors is not known",
            format!("add observations, or state descriptor_width in {}", names::INFO),
        ));
    };
    let mut info = info.into_info(&info_path, width)?;
    info.sessions = read_sessions(&folder.join(names::SESSIONS))?;
    read_features(folder, info.descriptor_kind, width, &mut keyframes)?;
    let mut contents = MapContents {
        cross_covariances: read_cross_covariances(folder, &keyframes)?,
        common_errors: read_common_errors(folder, &keyframes)?,
        aliases: read_aliases(folder, &keyframes)?,
        existence: read_existence(folder)?,
        keyframes: keyframes.into_values().collect(),
        landmarks: landmarks.into_values().collect(),
        ..MapContents::empty(info)
    };
    contents.sort();
    contents.validate().map_err(|reason| MapFileError::Contents { path: folder.to_owned(), reason })?;
    Ok(contents)
}

fn read_keyframes(folder: &Path) -> Result<BTreeMap<KeyframeId, Keyframe>, MapFileError> {
    let remedy = format!(
        "a map folder has {}, {}, {} and {}",
        names::KEYFRAMES,
        names::LANDMARKS,
        names::OBSERVATIONS,
        names::CAMERA
    );
    let table = Table::read(&folder.join(names::KEYFRAMES), &remedy)?;
    let mut cameras: HashMap<u32, Camera> = HashMap::new();
    let mut keyframes = BTreeMap::new();
    for row in table.rows() {
        row.expect_fields(11, 12, columns::KEYFRAMES)?;
        let camera_index = if row.len() == 12 { row.integer(11, "camera")? } else { 0 };
        let camera = if let Some(camera) = cameras.get(&camera_index) {
            camera.clone()
        } else {
            let camera = read_camera(&folder.join(names::camera(camera_index)))?;
            cameras.entry(camera_index).or_insert(camera).clone()
        };
        let keyframe = Keyframe {
            id: row.integer(0, "id")?,
            stamp_ns: row.integer(1, "timestamp")?,
            global_from_keyframe: PoseWithCovariance {
                pose: Pose::new(rotation(&row)?, Vector3::from(row.position(2, "position")?)),
                covariance: isotropic(&row)?,
            },
            camera,
            features: None,
        };
        let id = keyframe.id;
        if keyframes.insert(id, keyframe).is_some() {
            return Err(row.error(format!("keyframe {id} occurs twice"), "give every keyframe its own id"));
        }
    }
    Ok(keyframes)
}

fn rotation(row: &Row<'_>) -> Result<geometry::rotation::Rotation, MapFileError> {
    let [w, x, y, z] = row.numbers(5, "quaternion")?;
    let quaternion = Quaternion::new(w, x, y, z);
    let excess = (quaternion.norm_squared() - 1.0).abs();
    if excess <= UNIT_AS_WRITTEN {
        Ok(Unit::new_unchecked(quaternion))
    } else if excess <= UNIT_AT_ALL {
        Ok(Unit::new_normalize(quaternion))
    } else {
        Err(row.error(
            format!("the quaternion has length {}, not 1", quaternion.norm()),
            "write q_w, q_x, q_y, q_z of a unit quaternion",
        ))
    }
}

fn isotropic(row: &Row<'_>) -> Result<Matrix6<f64>, MapFileError> {
    let [theta, position]: [f64; 2] = row.numbers(9, "sigma")?;
    if theta < 0.0 || position < 0.0 {
        return Err(row.error("a sigma is negative", "write standard deviations in rad and m, 0 if exact"));
    }
    Ok(isotropic_covariance(theta, position))
}

fn keyframe_of<'a>(
    row: &Row<'_>,
    index: usize,
    keyframes: &'a BTreeMap<KeyframeId, Keyframe>,
) -> Result<&'a Keyframe, MapFileError> {
    let id: KeyframeId = row.integer(index, "keyframe")?;
    keyframes.get(&id).ok_or_else(|| {
        row.error(
            format!("keyframe {id} is not in {}", names::KEYFRAMES),
            "remove the record, or add the keyframe",
        )
    })
}

fn read_covariances(
    folder: &Path,
    keyframes: &mut BTreeMap<KeyframeId, Keyframe>,
) -> Result<(), MapFileError> {
    let Some(table) = Table::read_optional(&folder.join(names::COVARIANCES))? else { return Ok(()) };
    for row in table.rows() {
        row.expect_fields(37, 37, columns::COVARIANCES)?;
        let id = keyframe_of(&row, 0, keyframes)?.id;
        let covariance = Matrix6::from_row_slice(&row.numbers::<36>(1, "covariance")?);
        if let Some(keyframe) = keyframes.get_mut(&id) {
            keyframe.global_from_keyframe.covariance = covariance;
        }
    }
    Ok(())
}

fn read_cross_covariances(
    folder: &Path,
    keyframes: &BTreeMap<KeyframeId, Keyframe>,
) -> Result<Vec<KeyframeCrossCovariance>, MapFileError> {
    let Some(table) = Table::read_optional(&folder.join(names::CROSS_COVARIANCES))? else {
        return Ok(Vec::new());
    };
    table
        .rows()
        .map(|row| {
            row.expect_fields(38, 38, columns::CROSS_COVARIANCES)?;
            let (a, b) = (keyframe_of(&row, 0, keyframes)?.id, keyframe_of(&row, 1, keyframes)?.id);
            let block = Matrix6::from_row_slice(&row.numbers::<36>(2, "cross-covariance")?);
            Ok(KeyframeCrossCovariance { a, b, block })
        })
        .collect()
}

fn read_common_errors(
    folder: &Path,
    keyframes: &BTreeMap<KeyframeId, Keyframe>,
) -> Result<Vec<CommonError>, MapFileError> {
    let Some(table) = Table::read_optional(&folder.join(names::COMMON_ERRORS))? else {
        return Ok(Vec::new());
    };
    table
        .rows()
        .map(|row| {
            let whole = 1 + (row.len() - 1) / 6 * 6;
            row.expect_fields(whole, whole, columns::COMMON_ERRORS)?;
            let keyframe = keyframe_of(&row, 0, keyframes)?.id;
            let entries: Vec<f64> =
                (1..row.len()).map(|index| row.number(index, "factor")).collect::<Result<_, _>>()?;
            Ok(CommonError { keyframe, factor: Matrix6xX::from_column_slice(&entries) })
        })
        .collect()
}

fn read_aliases(
    folder: &Path,
    keyframes: &BTreeMap<KeyframeId, Keyframe>,
) -> Result<Vec<KeyframeAliases>, MapFileError> {
    let mut places: BTreeMap<KeyframeId, Vec<Alias>> = BTreeMap::new();
    let Some(table) = Table::read_optional(&folder.join(names::ALIASES))? else {
        return Ok(Vec::new());
    };
    for row in table.rows() {
        if row.len() != 1 {
            row.expect_fields(3, 3, columns::ALIASES)?;
        }
        let of_keyframe = places.entry(keyframe_of(&row, 0, keyframes)?.id).or_default();
        if row.len() == 3 {
            let keyframe = keyframe_of(&row, 1, keyframes)?.id;
            of_keyframe.push(Alias { keyframe, log_odds: row.number(2, "log-odds")? });
        }
    }
    Ok(places.into_iter().map(|(keyframe, places)| KeyframeAliases { keyframe, places }).collect())
}

fn read_existence(folder: &Path) -> Result<Vec<LandmarkExistence>, MapFileError> {
    let Some(table) = Table::read_optional(&folder.join(names::EXISTENCE))? else {
        return Ok(Vec::new());
    };
    let of_row = |row: Row<'_>| {
        row.expect_fields(4, 4, columns::EXISTENCE)?;
        Ok(LandmarkExistence {
            landmark: row.integer(0, "landmark")?,
            log_odds: row.number(1, "log-odds")?,
            stamp_ns: row.integer(2, "time")?,
            seen_ns: row.integer(3, "time")?,
        })
    };
    table.rows().map(of_row).collect()
}

fn read_landmarks(
    folder: &Path,
    keyframes: &BTreeMap<KeyframeId, Keyframe>,
) -> Result<BTreeMap<LandmarkId, Landmark>, MapFileError> {
    let table = Table::read(&folder.join(names::LANDMARKS), "a map needs its landmarks")?;
    let mut landmarks = BTreeMap::new();
    for row in table.rows() {
        row.expect_fields(5, 5, columns::LANDMARKS)?;
        let id = row.integer(0, "id")?;
        let landmark = Landmark {
            id,
            anchor: keyframe_of(&row, 1, keyframes)?.id,
            position_in_anchor: Vector3::from(row.position(2, "position")?),
            observations: Vec::new(),
        };
        if landmarks.insert(id, landmark).is_some() {
            return Err(row.error(format!("landmark {id} occurs twice"), "give every landmark its own id"));
        }
    }
    Ok(landmarks)
}

fn read_observations(
    folder: &Path,
    keyframes: &BTreeMap<KeyframeId, Keyframe>,
    landmarks: &mut BTreeMap<LandmarkId, Landmark>,
    width: &mut Option<u16>,
) -> Result<(), MapFileError> {
    let table = Table::read(&folder.join(names::OBSERVATIONS), "a map needs its observations")?;
    for row in table.rows() {
        row.expect_fields(5, 5, columns::OBSERVATIONS)?;
        let id: LandmarkId = row.integer(0, "landmark")?;
        let keyframe = keyframe_of(&row, 1, keyframes)?.id;
        let descriptor = descriptor(&row, 4, width)?;
        let Some(landmark) = landmarks.get_mut(&id) else {
            return Err(row.error(
                format!("landmark {id} is not in {}", names::LANDMARKS),
                "remove the observation, or add the landmark",
            ));
        };
        if landmark.observations.iter().any(|observation| observation.keyframe == keyframe) {
            return Err(row.error(
                format!("keyframe {keyframe} observes landmark {id} a second time"),
                "keep one observation of a landmark in a keyframe",
            ));
        }
        let pixel = [row.single(2, "u")?, row.single(3, "v")?];
        landmark.observations.push(Observation { keyframe, pixel, descriptor });
    }
    Ok(())
}

/// Reads a descriptor; the first one fixes the width of all.
fn descriptor(row: &Row<'_>, index: usize, width: &mut Option<u16>) -> Result<Vec<u8>, MapFileError> {
    let bytes = row.bytes(index, "descriptor")?;
    let found = u16::try_from(bytes.len())
        .map_err(|_| row.error("the descriptor is longer than 65535 bytes", "use shorter descriptors"))?;
    let wanted = *width.get_or_insert(found);
    if found != wanted {
        return Err(row.error(
            format!("the descriptor has {found} bytes, the map's have {wanted}"),
            "all descriptors of a map are of one width; a short last line means a truncated file",
        ));
    }
    Ok(bytes)
}

fn read_features(
    folder: &Path,
    kind: DescriptorKind,
    width: u16,
    keyframes: &mut BTreeMap<KeyframeId, Keyframe>,
) -> Result<(), MapFileError> {
    let Some(table) = Table::read_optional(&folder.join(names::FEATURES))? else { return Ok(()) };
    for row in table.rows() {
        row.expect_fields(1, 4, columns::FEATURES)?;
        let id = keyframe_of(&row, 0, keyframes)?.id;
        let Some(keyframe) = keyframes.get_mut(&id) else { continue };
        let features =
            keyframe.features.get_or_insert_with(|| FeatureSet::empty(DescriptorFormat { kind, width }));
        if row.len() == 1 {
            continue; // an image without features
        }
        row.expect_fields(4, 4, columns::FEATURES)?;
        features.pixels.push([row.single(1, "u")?, row.single(2, "v")?]);
        features.descriptors.bytes.extend(descriptor(&row, 3, &mut Some(width))?);
    }
    Ok(())
}
