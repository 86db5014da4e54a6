//! XFeat with its published weights: run with `--ignored` where `driftless weights xfeat` has put them.

use super::networks::{difference, map};
use super::published_networks::{xfeat, xfeat_shapes};
use crate::reference::Map;
use geometry::{Camera, Distortion, Pose};
use nalgebra::{Matrix3, Matrix4, Rotation3, UnitQuaternion, Vector2, Vector3};
use std::path::{Path, PathBuf};
use vision::features::weights::{WeightsError, XFEAT, default_folder};
use vision::features::xfeat::XfeatNetwork;
use vision::features::{StateDict, XfeatExtractor};
use vision::{DescriptorView, FeatureExtractor as _, GrayImage, MatchOptions, Metric, match_descriptors};

fn weights() -> PathBuf {
    let path = default_folder().join(XFEAT.file);
    assert!(path.exists(), "{} is missing; get it: {}", path.display(), XFEAT.command);
    path
}

#[test]
#[ignore = "needs the weights of XFeat"]
fn the_published_network_gives_the_numbers_of_a_direct_computation() {
    let path = weights();
    let state = StateDict::read(&std::fs::read(path).unwrap()).unwrap();
    let tensors = xfeat_shapes().into_iter().map(|(name, shape)| {
        let data = state.get(&name, &shape).unwrap().to_vec();
        (name, (shape, data))
    });
    let tensors = tensors.collect();
    let image =
        Map::from_fn(1, 64, 96, |_, y, x| ((y * 37 + x * 17) as f32 * 0.61).sin() + (x / 16 % 2) as f32);
    let expected = xfeat(&tensors, &image);
    let mut network = XfeatNetwork::new(&state).unwrap();
    for (found, expected) in network.run(&map(&image)).into_iter().zip(&expected) {
        let difference = difference(found, 0, expected);
        assert!(difference < 1e-4, "{difference}");
    }
}

#[test]
#[ignore = "needs the weights of XFeat"]
fn a_flipped_byte_of_the_published_weights_is_refused() {
    let path = weights();
    let bytes = std::fs::read(path).unwrap();
    let folder = tempfile::tempdir().unwrap();
    for position in [0, 100, bytes.len() / 2, bytes.len() - 1] {
        let mut damaged = bytes.clone();
        damaged[position] ^= 0x41;
        std::fs::write(folder.path().join(XFEAT.file), damaged).unwrap();
        let error = XfeatExtractor::open(folder.path()).err().unwrap();
        assert!(matches!(error, WeightsError::Checksum { .. }), "byte {position}: {error}");
    }
}

/// Left and right camera of EuRoC's V1 sequences, and `left_from_right`.
fn stereo() -> (Camera, Camera, Pose) {
    let camera = |focal, centre, distortion| Camera {
        width: 752,
        height: 480,
        focal,
        centre,
        distortion: Distortion::RadialTangential(distortion),
    };
    let left = camera(
        [458.654, 457.296],
        [367.215, 248.375],
        [-0.283_408_11, 0.073_959_07, 0.000_193_59, 1.761_871_14e-5],
    );
    let right = camera(
        [457.587, 456.134],
        [379.999, 255.238],
        [-0.283_683_65, 0.074_512_84, -0.000_104_73, -3.555_907e-5],
    );
    let imu_from_left = Matrix4::new(
        0.014_865_542_981_8,
        -0.999_880_929_698,
        0.004_140_296_794_22,
        -0.021_640_145_497_5,
        0.999_557_249_008,
        0.014_967_213_324_7,
        0.025_715_529_948,
        -0.064_676_986_768,
        -0.025_774_436_697_4,
        0.003_756_188_357_97,
        0.999_660_727_178,
        0.009_810_730_589_49,
        0.0,
        0.0,
        0.0,
        1.0,
    );
    let imu_from_right = Matrix4::new(
        0.012_555_267_089_1,
        -0.999_755_099_723,
        0.018_223_771_455_4,
        -0.019_843_557_955_6,
        0.999_598_781_151,
        0.013_011_905_181_5,
        0.025_158_836_311_5,
        0.045_368_942_502_4,
        -0.025_389_800_891_8,
        0.017_900_583_825_3,
        0.999_517_347_078,
        0.007_862_124_470_38,
        0.0,
        0.0,
        0.0,
        1.0,
    );
    let pose = |matrix: Matrix4<f64>| {
        let rotation: Matrix3<f64> = matrix.fixed_view::<3, 3>(0, 0).into_owned();
        let translation: Vector3<f64> = matrix.fixed_view::<3, 1>(0, 3).into_owned();
        Pose::new(UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix(&rotation)), translation)
    };
    (left, right, pose(imu_from_left).inverse().compose(&pose(imu_from_right)))
}

#[test]
#[ignore = "needs the weights of XFeat, and the recordings in target/data"]
fn most_matches_between_two_cameras_keep_the_epipolar_line() {
    let path = weights();
    let sequence =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target/data/images/v1_01_keyframes/mav0");
    assert!(sequence.is_dir(), "images/v1_01_keyframes is not unpacked in target/data");
    let mut extractor = XfeatExtractor::open(path.parent().unwrap()).unwrap();
    let (left, right, left_from_right) = stereo();
    let options = MatchOptions { max_distance: 0.2, ratio: Some(0.8), mutual: true };
    let mut names: Vec<_> = std::fs::read_dir(sequence.join("cam0/data")).unwrap().flatten().collect();
    names.sort_by_key(std::fs::DirEntry::file_name);
    let (mut good, mut all, mut pairs) = (0, 0, 0);
    for name in names.iter().step_by(20) {
        let [a, b] = ["cam0", "cam1"].map(|camera| {
            let image = GrayImage::read(&sequence.join(camera).join("data").join(name.file_name())).unwrap();
            extractor.extract(&image, None, 1000).unwrap()
        });
        let view = |bytes| DescriptorView::new(Metric::CosineInt8, 64, bytes).unwrap();
        for found in match_descriptors(view(&a.descriptors), view(&b.descriptors), &options).unwrap() {
            let ray = |camera: &Camera, [u, v]: [f32; 2]| {
                camera.bearing(&Vector2::new(f64::from(u), f64::from(v))).unwrap().into_inner()
            };
            let ray_left = ray(&left, a.keypoints[found.query].pixel);
            let ray_right = left_from_right.rotation * ray(&right, b.keypoints[found.train].pixel);
            // Sine of the angle between the left ray and the plane of the right ray and the baseline.
            let normal = left_from_right.translation.cross(&ray_right).normalize();
            good += usize::from(ray_left.dot(&normal).abs() < 2.0 / 458.0);
            all += 1;
        }
        pairs += 1;
    }
    assert!(good > 300 * pairs && 10 * good > 7 * all, "{good} of {all} matches of {pairs} pairs");
}
