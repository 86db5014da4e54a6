//! Models of COLMAP.

use map_io::colmap::read_model;

/// The three files of a model, as [`colmap_files`] divides bytes.
///
/// # Panics
/// Reading does, or a camera that was read is not valid.
pub fn colmap_models(data: &[u8]) {
    let (extension, files) = colmap_files(data);
    let folder = tempfile::tempdir().expect("a temporary folder");
    for (name, bytes) in ["cameras", "images", "points3D"].iter().zip(files) {
        let path = folder.path().join(name).with_extension(extension);
        std::fs::write(path, bytes).expect("a temporary file");
    }
    if let Ok(model) = read_model(folder.path()) {
        for camera in model.cameras.values() {
            camera.validate().expect("a camera that was read is valid");
        }
    }
}

/// How the names of the files end, and `cameras`, `images` and `points3D`: behind `b` (binary) or another byte (text) and the lengths of
/// the first two as little-endian `u16`. What is missing is empty.
pub fn colmap_files(data: &[u8]) -> (&'static str, [&[u8]; 3]) {
    let Some(([kind, first_0, first_1, second_0, second_1], rest)) = data.split_first_chunk() else {
        return ("bin", [&[]; 3]);
    };
    let length = |bytes: [&u8; 2]| usize::from(u16::from_le_bytes(bytes.map(|byte| *byte)));
    let (cameras, rest) = rest.split_at(length([first_0, first_1]).min(rest.len()));
    let (images, points) = rest.split_at(length([second_0, second_1]).min(rest.len()));
    (if *kind == b'b' { "bin" } else { "txt" }, [cameras, images, points])
}
