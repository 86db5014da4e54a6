//! Records of a map's database.

use map::store::record::{
    CommonErrorRecord, CrossCovarianceRecord, InfoRecord, KeyframeRecord, LandmarkRecord, RecordError, unseal,
};

/// Key of the record; any, since the checksum is made for it.
const KEY: &[u8] = &[0, 0, 0, 0, 0, 0, 0, 1];

/// Records of every table: the bytes as they are, and as the payload of an intact envelope, so that mutations get past
/// the checksum. The first byte is the record's version.
pub fn store_records(data: &[u8]) {
    read_all(|_| data.to_vec());
    let Some((&version, payload)) = data.split_first() else { return };
    read_all(|table| sealed(table, version, payload));
}

fn read_all(bytes: impl Fn(&str) -> Vec<u8>) {
    let _ = unseal::<InfoRecord>("info", KEY, &bytes("info")).and_then(InfoRecord::into_info);
    let keyframe = unseal::<KeyframeRecord>("keyframes", KEY, &bytes("keyframes"));
    let _ = keyframe.and_then(|record| record.into_keyframe(1));
    let _ =
        unseal::<LandmarkRecord>("landmarks", KEY, &bytes("landmarks")).map(|record| record.into_landmark(1));
    let cross: Result<CrossCovarianceRecord, RecordError> =
        unseal("cross_covariances", KEY, &bytes("cross_covariances"));
    let _ = cross.map(|record| record.into_cross_covariance(1, 2));
    let common: Result<CommonErrorRecord, RecordError> =
        unseal("common_errors", KEY, &bytes("common_errors"));
    let _ = common.map(|record| record.into_common_error(1));
}

fn sealed(table: &str, version: u8, payload: &[u8]) -> Vec<u8> {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(table.as_bytes());
    hasher.update(KEY);
    hasher.update(&[version]);
    hasher.update(payload);
    let mut bytes = vec![version];
    bytes.extend_from_slice(&hasher.finalize().to_le_bytes());
    bytes.extend_from_slice(payload);
    bytes
}
