//! Databases as programs of store schema 1 and 2 wrote them: sled without checksums around it.

use map::store::record::{CrossCovarianceRecord, InfoRecord, KeyframeRecord, LandmarkRecord, seal};
use map::{MapContents, MapMetadata};

/// Bytes before the payload of a record: its version and its checksum.
const HEADER_BYTES: usize = 5;

/// Changes a record: the name of its tree, its key, its value.
pub type ChangeRecord<'a> = &'a dyn Fn(&str, &[u8], &mut Vec<u8>);

/// Writes a map as a database of schema 1 or 2. `change` gets every record with its table and key, and may damage it.
pub fn write_former_database(
    path: &std::path::Path,
    contents: &MapContents,
    schema: u16,
    change: ChangeRecord<'_>,
) {
    let database = sled::Config::new().path(path).flush_every_ms(None).open().unwrap();
    let write = |table: &str, key: &[u8], record: Vec<u8>| {
        let mut bytes = former_bytes(table, key, schema as u8, &record[HEADER_BYTES..]);
        change(table, key, &mut bytes);
        database.open_tree(table).unwrap().insert(key, bytes).unwrap();
    };
    for keyframe in &contents.keyframes {
        let key = keyframe.id.to_be_bytes();
        write("keyframes", &key, seal("keyframes", &key, &KeyframeRecord::new(keyframe)).unwrap());
    }
    for landmark in &contents.landmarks {
        let key = landmark.id.to_be_bytes();
        write("landmarks", &key, seal("landmarks", &key, &LandmarkRecord::new(landmark)).unwrap());
    }
    for cross in &contents.cross_covariances {
        let key = [cross.a.to_be_bytes(), cross.b.to_be_bytes()].concat();
        write(
            "cross_covariances",
            &key,
            seal("cross_covariances", &key, &CrossCovarianceRecord::new(cross)).unwrap(),
        );
    }
    // Since then an identity was added at the end, one byte where there is none; before schema 2 there was no extractor.
    let info = MapMetadata { identity: None, ..contents.info.clone() };
    let mut record = seal("info", b"info", &InfoRecord::new(&info)).unwrap();
    record.pop();
    if schema == 1 {
        record.truncate(record.len() - 8 - info.extractor.len());
    }
    write("info", b"info", record);
    let tree = database.open_tree("info").unwrap();
    tree.insert("schema", [b"DRFTMAP", &schema.to_le_bytes()[..]].concat()).unwrap();
    database.flush().unwrap();
    drop((tree, database));
    // sled's threads let go of the files a moment later.
    let file = std::fs::File::open(path.join("db")).unwrap();
    while file.try_lock().is_err() {
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
}

/// A record in its envelope.
pub fn former_bytes(table: &str, key: &[u8], version: u8, payload: &[u8]) -> Vec<u8> {
    let mut hasher = crc32fast::Hasher::new();
    for part in [table.as_bytes(), key, &[version], payload] {
        hasher.update(part);
    }
    [&[version], &hasher.finalize().to_le_bytes()[..], payload].concat()
}
