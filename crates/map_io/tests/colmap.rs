//! Models that COLMAP wrote (by `make.py` in `tests/data/colmap_model` and `tests/data/colmap_lenses`), ours, and damaged ones.

use geometry::Distortion;
use map_io::colmap::{ColmapModel, ReadColmapError, read_model};
use std::fs;
use std::path::{Path, PathBuf};

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

/// A copy of the model with the files that end so.
fn copy(extension: &str) -> tempfile::TempDir {
    copy_of("colmap_model", extension)
}

fn copy_of(model: &str, extension: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for file in fs::read_dir(data(model)).unwrap() {
        let path = file.unwrap().path();
        if path.extension().is_some_and(|found| found == extension) {
            fs::copy(&path, folder.path().join(path.file_name().unwrap())).unwrap();
        }
    }
    folder
}

fn assert_points_project_to_their_pixels(model: &ColmapModel) {
    for image in model.images.values() {
        for seen in &image.pixels {
            let in_camera = image.world_from_camera.inverse_transform(&model.points[&seen.point]);
            let pixel = model.cameras[&image.camera].project(&in_camera).unwrap();
            assert!((pixel - nalgebra::Vector2::from(seen.pixel)).norm() < 1e-9, "{}: {pixel}", image.name);
        }
    }
}

#[test]
fn binary_and_text_are_the_same_model_and_its_points_project_to_their_pixels() {
    let binary = read_model(copy("bin").path()).unwrap();
    let text = read_model(copy("txt").path()).unwrap();
    assert_eq!(binary, text);
    assert_eq!((binary.cameras.len(), binary.images.len(), binary.points.len()), (2, 3, 4));
    assert_eq!(binary.images[&3].name, "a photo.jpg");
    // One of its five pixels is of no point.
    assert_eq!(binary.images[&3].pixels.len(), 4);
    assert_points_project_to_their_pixels(&binary);
}

#[test]
fn the_full_model_of_opencv_and_the_fisheye_with_a_thin_prism_are_colmaps() {
    let binary = read_model(copy_of("colmap_lenses", "bin").path()).unwrap();
    assert_eq!(binary, read_model(copy_of("colmap_lenses", "txt").path()).unwrap());
    assert_points_project_to_their_pixels(&binary);
    assert_eq!(binary.images.values().map(|image| image.pixels.len()).sum::<usize>(), 16);
    let distortion = |camera: u32| binary.cameras[&camera].distortion;
    assert_eq!(distortion(1).coefficients(), [0.51, -2.69, 3e-4, -1e-4, 1.53, 0.39, -2.51, 1.46]);
    let prism = [-0.04, 0.0116, 2.1e-4, -3.9e-4, -0.0043, 8e-4, 6.1e-4, -9.3e-4];
    assert_eq!(distortion(2), Distortion::ThinPrismFisheye(prism));
    assert_eq!(distortion(3).coefficients(), [0.11, -0.23, 7e-4, -3e-4, 0.11]);
    assert_eq!(distortion(4), Distortion::RadialTangential([0.11, -0.23, 7e-4, -3e-4]));
}

#[test]
fn a_file_that_is_cut_off_anywhere_is_named() {
    for (extension, names) in [
        ("bin", ["cameras.bin", "images.bin", "points3D.bin"]),
        ("txt", ["cameras.txt", "images.txt", "points3D.txt"]),
    ] {
        let folder = copy(extension);
        let whole = read_model(folder.path()).unwrap();
        for name in names {
            let path = folder.path().join(name);
            let bytes = fs::read(&path).unwrap();
            for end in 0..bytes.len() {
                fs::write(&path, &bytes[..end]).unwrap();
                match read_model(folder.path()) {
                    // A text says nowhere how many lines it has.
                    Ok(model) => {
                        assert_eq!(extension, "txt", "{name} cut off at {end}");
                        assert!(model.images.len() <= whole.images.len());
                    }
                    Err(error) => {
                        let said = error.to_string();
                        let names_it = said.contains(name) || said.contains("the model does not have");
                        assert!(names_it || said.contains("camera"), "{said}");
                    }
                }
            }
            fs::write(&path, &bytes).unwrap();
        }
    }
}

#[test]
fn bytes_that_are_wrong_are_refused_or_read_but_never_a_panic() {
    let folder = copy("bin");
    for name in ["cameras.bin", "images.bin", "points3D.bin"] {
        let path = folder.path().join(name);
        let bytes = fs::read(&path).unwrap();
        for index in 0..bytes.len() {
            for flip in [0x01, 0x80, 0xff] {
                let mut damaged = bytes.clone();
                damaged[index] ^= flip;
                fs::write(&path, &damaged).unwrap();
                if let Ok(model) = read_model(folder.path()) {
                    assert!(model.points.values().all(|point| point.iter().all(|value| value.is_finite())));
                }
            }
        }
        fs::write(&path, &bytes).unwrap();
    }
}

#[test]
fn folders_and_cameras_that_are_none_are_named() {
    let empty = tempfile::tempdir().unwrap();
    assert!(matches!(read_model(empty.path()), Err(ReadColmapError::NoModel { .. })));
    let folder = copy("txt");
    let cameras = folder.path().join("cameras.txt");
    let unsupported = "1 RAD_TAN_THIN_PRISM_FISHEYE 752 480 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16\n";
    fs::write(&cameras, unsupported).unwrap();
    let error = read_model(folder.path()).unwrap_err();
    assert!(error.to_string().contains("RAD_TAN_THIN_PRISM_FISHEYE"), "{error}");
    fs::write(&cameras, "1 PINHOLE 752 480 458 457 367.5 248.5\n").unwrap();
    let error = read_model(folder.path()).unwrap_err();
    assert!(matches!(&error, ReadColmapError::Dangling { image, .. } if image == "a photo.jpg"), "{error}");
}
