//! A round trip changes nothing, and bad files are named with the line.

use std::path::Path;

use geometry::camera::{Camera, Distortion};
use geometry::pose::Pose;
use geometry::uncertain_pose::{PoseWithCovariance, isotropic_covariance};
use map::contents::MapContents;
use map::model::{CommonError, Keyframe, KeyframeCrossCovariance, Landmark, MapMetadata, Observation};
use map::sessions::{ReadingSamples, Session, SessionId};
use nalgebra::{Matrix6, Matrix6xX, Vector3};
use protocol::{DescriptorKind, Descriptors, FeatureSet};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

use super::{MapFileError, read_map, write_map};

fn camera(rng: &mut StdRng, distortion: Distortion) -> Camera {
    let focal = rng.random_range(400.0..500.0);
    Camera { width: 752, height: 480, focal: [focal, focal + 1.0 / 3.0], centre: [375.1, 239.7], distortion }
}

fn covariance(rng: &mut StdRng) -> Matrix6<f64> {
    let a = Matrix6::from_fn(|_, _| rng.random_range(-0.1..0.1));
    let product = a * a.transpose();
    (product + product.transpose()) * 0.5 + Matrix6::identity() * 1e-3
}

/// 32 bytes that are as well a descriptor of bits as one of eight numbers.
fn descriptor(rng: &mut StdRng) -> Vec<u8> {
    (0..8).flat_map(|_| rng.random_range(-1.0_f32..1.0).to_le_bytes()).collect()
}

/// A random map; `rich` ones need every optional file.
fn random_map(seed: u64, rich: bool) -> MapContents {
    let mut rng = StdRng::seed_from_u64(seed);
    let mut info = MapMetadata::new("map", "driftless import-map", DescriptorKind::Binary, 32);
    let cameras = [
        camera(&mut rng, Distortion::RadialTangential([-0.28, 0.07, 1.9e-4, 1.76e-5])),
        camera(&mut rng, Distortion::Fov(0.93)),
    ];
    if rich {
        info.name = "an \"odd\" name: with, commas\nand lines".to_owned();
        info.gravity_in_global = Some(Vector3::new(rng.random_range(-1.0..1.0), 0.3, -1.0).normalize());
        info.sigma_px = 1.0 / 3.0;
        info.descriptor_kind = DescriptorKind::Float;
    }
    let mut contents = MapContents::empty(info);
    for id in 1..=8_u64 {
        let rotation = geometry::rotation::exp(&Vector3::from_fn(|_, _| rng.random_range(-1.5..1.5)));
        let pose = Pose::new(rotation, Vector3::from_fn(|_, _| rng.random_range(-100.0..100.0)));
        let full = rich && id % 2 == 0;
        let covariance =
            if full { covariance(&mut rng) } else { isotropic_covariance(0.0158, 0.1 / id as f64) };
        let features = full.then(|| FeatureSet {
            pixels: (0..id - 2).map(|_| [rng.random_range(0.0..700.0), 1.0e-7]).collect(),
            descriptors: Descriptors {
                kind: DescriptorKind::Float,
                width: 32,
                bytes: (0..id - 2).flat_map(|_| descriptor(&mut rng)).collect(),
            },
            extractor: String::new(),
        });
        contents.keyframes.push(Keyframe {
            id: id * 3,
            stamp_ns: 1_403_636_751_713_555_456 + id as i64,
            global_from_keyframe: PoseWithCovariance { pose, covariance },
            camera: cameras[usize::from(full)].clone(),
            features,
        });
    }
    for id in 0..40_u64 {
        let first = rng.random_range(1..=6_u64);
        let observations = (first..first + 3)
            .map(|keyframe| Observation {
                keyframe: keyframe * 3,
                pixel: [rng.random_range(0.0..700.0), rng.random_range(0.0..400.0)],
                descriptor: descriptor(&mut rng),
            })
            .collect();
        contents.landmarks.push(Landmark {
            id: id * 7 + 1,
            anchor: first * 3 + 3,
            position_in_anchor: Vector3::from_fn(|_, _| rng.random_range(-30.0..30.0)),
            observations,
        });
    }
    if rich {
        let block = Matrix6::from_fn(|_, _| rng.random_range(-1e-5..1e-5));
        contents.cross_covariances.push(KeyframeCrossCovariance { a: 6, b: 12, block });
        for keyframe in [6, 12, 24] {
            let factor = Matrix6xX::from_fn(7, |_, _| rng.random_range(-1e-3..1e-3));
            contents.common_errors.push(CommonError { keyframe, factor });
        }
    }
    if rich {
        contents.ensure_sessions("a \"recording\", odd: name");
        contents.info.sessions[0].robot = Some("ada".to_owned());
        contents.info.sessions[0].added_unix_s = Some(seed);
    }
    contents.sort();
    contents.validate().unwrap();
    contents
}

#[test]
fn reading_a_written_map_gives_an_equal_map() {
    for seed in 0..20 {
        for rich in [false, true] {
            let folder = tempfile::tempdir().unwrap();
            let contents = random_map(seed, rich);
            write_map(folder.path(), &contents).unwrap();
            assert_eq!(read_map(folder.path()).unwrap(), contents);
        }
    }
}

#[test]
fn writing_a_read_map_gives_the_same_files() {
    for rich in [false, true] {
        let (first, second) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        write_map(first.path(), &random_map(7, rich)).unwrap();
        write_map(second.path(), &read_map(first.path()).unwrap()).unwrap();
        let files = |folder: &Path| {
            let mut files: Vec<_> = std::fs::read_dir(folder)
                .unwrap()
                .map(|entry| entry.unwrap())
                .map(|entry| (entry.file_name(), std::fs::read_to_string(entry.path()).unwrap()))
                .collect();
            files.sort();
            files
        };
        assert_eq!(files(first.path()), files(second.path()));
    }
}

#[test]
fn a_map_that_two_sigmas_describe_is_four_files() {
    let folder = tempfile::tempdir().unwrap();
    write_map(folder.path(), &random_map(1, false)).unwrap();
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 4);
}

#[test]
fn a_map_is_never_written_over_another() {
    let folder = tempfile::tempdir().unwrap();
    write_map(folder.path(), &random_map(1, false)).unwrap();
    let again = write_map(folder.path(), &random_map(2, false));
    assert!(matches!(again, Err(MapFileError::Occupied { .. })));
}

/// Writes a good map, changes one file, and returns what reading says.
fn complaint_about(file: &str, change: impl Fn(&str) -> String) -> String {
    let folder = tempfile::tempdir().unwrap();
    write_map(folder.path(), &random_map(3, false)).unwrap();
    let path = folder.path().join(file);
    std::fs::write(&path, change(&std::fs::read_to_string(&path).unwrap())).unwrap();
    read_map(folder.path()).unwrap_err().to_string()
}

#[test]
fn a_truncated_line_is_named() {
    let said = complaint_about("observations.csv", |text| text[..text.len() - 30].to_owned());
    assert!(said.contains("observations.csv, line 121"), "{said}");
    let said = complaint_about("keyframes.csv", |text| text[..text.len() - 40].to_owned());
    assert!(said.contains("keyframes.csv, line 9"), "{said}");
}

#[test]
fn a_number_that_is_none_is_named() {
    let said = complaint_about("landmarks.csv", |text| format!("{text}999,3,nan,0,1\n"));
    assert!(said.contains("landmarks.csv, line 42") && said.contains("no finite number"), "{said}");
}

#[test]
fn a_position_beyond_the_bound_is_named() {
    let said = complaint_about("landmarks.csv", |text| format!("{text}999,3,0,1e300,1\n"));
    assert!(said.contains("landmarks.csv, line 42") && said.contains("position"), "{said}");
    assert!(said.contains("1e300 m, more than 1e7 m"), "{said}");
    let said = complaint_about("keyframes.csv", |text| format!("{text}99,1,0,0,-2e7,1,0,0,0,0.01,0.1\n"));
    assert!(said.contains("keyframes.csv, line 10") && said.contains("-2e7 m"), "{said}");
}

#[test]
fn a_reference_to_nothing_is_named() {
    let said = complaint_about("observations.csv", |text| format!("{text}1,4,10,10,00\n"));
    assert!(said.contains("line 122") && said.contains("keyframe 4 is not in keyframes.csv"), "{said}");
    let said = complaint_about("landmarks.csv", |text| format!("{text}999,3,0,0,1\n"));
    assert!(said.contains("landmark 999"), "{said}");
}

#[test]
fn a_quaternion_that_is_none_is_named() {
    let said =
        complaint_about("keyframes.csv", |text| format!("{text}99,1,0,0,0,0.5,0.5,0.5,0.1,0.01,0.1\n"));
    assert!(said.contains("keyframes.csv, line 10") && said.contains("quaternion"), "{said}");
}

#[test]
fn a_missing_or_broken_camera_is_named() {
    let said = complaint_about("camera.yaml", |_| "resolution: [752, 480]\n".to_owned());
    assert!(said.contains("camera.yaml") && said.contains("intrinsics"), "{said}");
    let said = complaint_about("camera.yaml", |text| text.replace("radial-tangential", "mei"));
    assert!(said.contains("mei"), "{said}");
}

#[test]
fn the_cameras_of_euroc_are_read() {
    let folder = tempfile::tempdir().unwrap();
    write_map(folder.path(), &random_map(3, false)).unwrap();
    let text = "%YAML:1.0\n# General\nsensor_type: camera\ncomment: VI-Sensor cam0 (MT9M034)\nT_BS:\n  cols: 4\n  \
                rows: 4\n  data: [1.0, 0.0, 0.0, 0.0,\n         0.0, 1.0, 0.0, 0.0,\n        0.0, 0.0, 1.0, 0.0,\n  \
                       0.0, 0.0, 0.0, 1.0]\nrate_hz: 20\nresolution: [752, 480]\ncamera_model: pinhole\nintrinsics: \
                [458.654, 457.296, 367.215, 248.375] #fu, fv, cu, cv\ndistortion_model: radial-tangential\n\
                distortion_coefficients: [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]\n\n";
    std::fs::write(folder.path().join("camera.yaml"), text).unwrap();
    let camera = &read_map(folder.path()).unwrap().keyframes[0].camera;
    let expected = Camera {
        width: 752,
        height: 480,
        focal: [458.654, 457.296],
        centre: [367.215, 248.375],
        distortion: Distortion::RadialTangential([
            -0.283_408_11,
            0.073_959_07,
            0.000_193_59,
            1.761_871_14e-05,
        ]),
    };
    assert_eq!(*camera, expected);
}

#[test]
fn a_ledger_in_which_two_sessions_have_the_same_readings_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    write_map(folder.path(), &random_map(3, true)).unwrap();
    let path = folder.path().join("sessions.json");
    let mut sessions: Vec<Session> = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    sessions[0].samples = ReadingSamples::of_digests(vec![5, 7]);
    let mut again = Session { id: SessionId::from_bytes([9; 16]), ..sessions[0].clone() };
    again.name = "the same with another name".to_owned();
    again.keyframe_ids = sessions[0].keyframe_ids.map(|id| id + 1_000_000);
    sessions.push(again);
    let write = |sessions: &[Session]| std::fs::write(&path, serde_json::to_vec(sessions).unwrap()).unwrap();
    write(&sessions);
    let error = read_map(folder.path()).unwrap_err().to_string();
    assert!(error.contains("sessions.json") && error.contains("another name"), "{error}");
    sessions[1].samples = ReadingSamples::of_digests(vec![11]);
    write(&sessions);
    read_map(folder.path()).unwrap();
}

#[test]
fn the_keyframes_without_which_nothing_is_read_are_written_last() {
    let folder = tempfile::tempdir().unwrap();
    // They cannot be written: the place is taken.
    let occupied = folder.path().join(format!("{}.unfinished", super::names::KEYFRAMES));
    std::fs::create_dir_all(occupied.join("x")).unwrap();
    let _ = write_map(folder.path(), &random_map(3, true)).unwrap_err();
    let written = |name: &str| folder.path().join(name).exists();
    assert!(written(super::names::COVARIANCES) && written(super::names::OBSERVATIONS));
    assert!(!written(super::names::KEYFRAMES));
    read_map(folder.path()).unwrap_err();
}
