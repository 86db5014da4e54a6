//! Writes files as `torch.save` does: a pickle of protocol 2 and the numbers, in a zip archive.

use super::reference::Tensors;
use std::io::{Cursor, Write as _};
use zip::write::{SimpleFileOptions, ZipWriter};

/// The file of a table of tensors.
pub fn write(tensors: &Tensors) -> Vec<u8> {
    let storages: Vec<Vec<u8>> = tensors
        .values()
        .map(|(_, data)| data.iter().flat_map(|number| number.to_le_bytes()).collect())
        .collect();
    archive(&table(tensors), &storages)
}

/// An archive of a pickle and of storages.
pub fn archive(pickle: &[u8], storages: &[Vec<u8>]) -> Vec<u8> {
    let options = SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    zip.start_file("archive/data.pkl", options).unwrap();
    zip.write_all(pickle).unwrap();
    for (index, storage) in storages.iter().enumerate() {
        zip.start_file(format!("archive/data/{index}"), options).unwrap();
        zip.write_all(storage).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

/// The pickle: storage `i` belongs to tensor `i`.
pub fn table(tensors: &Tensors) -> Vec<u8> {
    let mut pickle = b"\x80\x02ccollections\nOrderedDict\n)R(".to_vec();
    for (index, (name, (shape, data))) in tensors.iter().enumerate() {
        text(&mut pickle, name);
        pickle.extend_from_slice(b"ctorch._utils\n_rebuild_tensor_v2\n((");
        text(&mut pickle, "storage");
        pickle.extend_from_slice(b"ctorch\nFloatStorage\n");
        text(&mut pickle, &index.to_string());
        text(&mut pickle, "cpu");
        integer(&mut pickle, data.len());
        pickle.extend_from_slice(b"tQK\x00(");
        for &size in shape {
            integer(&mut pickle, size);
        }
        pickle.extend_from_slice(b"t(");
        for axis in 0..shape.len() {
            integer(&mut pickle, shape[axis + 1..].iter().product());
        }
        pickle.extend_from_slice(b"t\x89ccollections\nOrderedDict\n)RtR");
    }
    pickle.extend_from_slice(b"u.");
    pickle
}

fn text(pickle: &mut Vec<u8>, text: &str) {
    pickle.push(b'X');
    pickle.extend_from_slice(&(text.len() as u32).to_le_bytes());
    pickle.extend_from_slice(text.as_bytes());
}

fn integer(pickle: &mut Vec<u8>, value: usize) {
    pickle.push(b'J');
    pickle.extend_from_slice(&(value as i32).to_le_bytes());
}
