//! A written model against COLMAP's own definitions.

use super::{ColmapError, ReadColmapError, WrittenModel, image_names, read_model, write_model};
use geometry::camera::{Camera, Distortion};
use geometry::uncertain_pose::{PoseWithCovariance, isotropic_covariance};
use geometry::{Pose, rotation};
use map::MapContents;
use map::model::{Keyframe, Landmark, MapMetadata, Observation};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use protocol::DescriptorKind;

/// Two keyframes that see three landmarks, pixels without noise.
fn map() -> MapContents {
    let distortion = Distortion::RadialTangential([-0.28, 0.07, 2e-4, 2e-5]);
    let camera =
        Camera { width: 752, height: 480, focal: [458.0, 457.0], centre: [367.0, 248.0], distortion };
    let poses =
        [0.0, 0.3].map(|x| Pose::new(rotation::exp(&Vector3::new(0.1, x, -0.2)), Vector3::new(x, 1.0, 2.0)));
    let keyframe = |index: usize| Keyframe {
        id: index as u64 + 1,
        stamp_ns: 1_000_000_000 * (index as i64 + 1),
        global_from_keyframe: PoseWithCovariance::new(poses[index], isotropic_covariance(0.01, 0.02)),
        camera: camera.clone(),
        features: None,
    };
    let landmark = |id: u64| {
        let in_anchor = Vector3::new(0.4 * id as f64 - 1.0, 0.2, 4.0 + id as f64);
        let in_global = poses[0].transform(&in_anchor);
        let observation = |index: usize| {
            let pixel = camera.project(&poses[index].inverse_transform(&in_global)).unwrap();
            let pixel = [pixel.x as f32, pixel.y as f32];
            Observation { keyframe: index as u64 + 1, pixel, descriptor: vec![id as u8; 32] }
        };
        let observations = vec![observation(0), observation(1)];
        Landmark { id, anchor: 1, position_in_anchor: in_anchor, observations }
    };
    let mut contents = MapContents::empty(MapMetadata::new("hall", "test", DescriptorKind::Binary, 32));
    contents.keyframes = vec![keyframe(0), keyframe(1)];
    contents.landmarks = vec![landmark(1), landmark(2), landmark(3)];
    contents
}

fn numbers(line: &str) -> Vec<f64> {
    line.split(' ').map_while(|word| word.parse().ok()).collect()
}

#[test]
fn points_project_to_their_pixels_by_colmaps_definitions() {
    let folder = tempfile::tempdir().unwrap();
    write_model(folder.path(), &map(), |keyframe| format!("{}.png", keyframe.stamp_ns)).unwrap();
    let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap();
    let lines = |text: &str| -> Vec<String> {
        text.lines().filter(|line| !line.starts_with('#')).map(str::to_owned).collect()
    };
    let cameras = read("cameras.txt");
    let camera = lines(&cameras).remove(0);
    let parameters = numbers(camera.strip_prefix("1 OPENCV 752 480 ").unwrap());
    let [fx, fy, cx, cy, k1, k2, p1, p2] = parameters[..] else { panic!("{camera}") };
    let images = lines(&read("images.txt"));
    assert!(
        images[0].ends_with(" 1 1000000000.png") && images[2].ends_with(" 1 2000000000.png"),
        "{images:?}"
    );
    for point in lines(&read("points3D.txt")) {
        let point = numbers(&point);
        let position = Vector3::new(point[1], point[2], point[3]);
        assert!(point[7] < 1e-3, "error {}", point[7]);
        assert_eq!(point.len(), 8 + 2 * 2);
        for track in point[8..].chunks(2) {
            let line = 2 * (track[0] as usize - 1);
            let [_, w, x, y, z, tx, ty, tz, ..] = numbers(&images[line])[..] else { panic!() };
            let turn = UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z));
            let in_camera = turn * position + Vector3::new(tx, ty, tz);
            let (u, v) = (in_camera.x / in_camera.z, in_camera.y / in_camera.z);
            let r2 = u * u + v * v;
            let radial = 1.0 + k1 * r2 + k2 * r2 * r2;
            let du = u * radial + 2.0 * p1 * u * v + p2 * (r2 + 2.0 * u * u);
            let dv = v * radial + 2.0 * p2 * u * v + p1 * (r2 + 2.0 * v * v);
            let seen = &numbers(&images[line + 1])[3 * track[1] as usize..][..3];
            assert!((fx * du + cx - seen[0]).abs() < 1e-3 && (fy * dv + cy - seen[1]).abs() < 1e-3);
            assert_eq!(seen[2] as u64, point[0] as u64);
        }
    }
    let again = write_model(folder.path(), &map(), |keyframe| keyframe.id.to_string());
    assert!(matches!(again, Err(ColmapError::Occupied { .. })), "{again:?}");
}

#[test]
fn a_written_model_is_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let map = map();
    write_model(folder.path(), &map, |keyframe| format!("{}.png", keyframe.stamp_ns)).unwrap();
    let model = read_model(folder.path()).unwrap();
    assert_eq!((model.images.len(), model.points.len()), (2, 3));
    for keyframe in &map.keyframes {
        let image = &model.images[&u32::try_from(keyframe.id).unwrap()];
        assert!(image.world_from_camera.local(&keyframe.global_from_keyframe.pose).norm() < 1e-12);
        let camera = &model.cameras[&image.camera];
        assert_eq!((camera.focal, camera.distortion), (keyframe.camera.focal, keyframe.camera.distortion));
        assert!((camera.centre[0] - keyframe.camera.centre[0]).abs() < 1e-9);
        let seen = map
            .landmarks
            .iter()
            .flat_map(|landmark| landmark.observations.iter().map(|seen| (landmark.id, seen)));
        for (id, seen) in seen.filter(|(_, seen)| seen.keyframe == keyframe.id) {
            let read = image.pixels.iter().find(|pixel| pixel.point == id).unwrap();
            assert!((read.pixel[0] - f64::from(seen.pixel[0])).abs() < 1e-9);
        }
    }
}

/// The same, seen by a stereo pair at each of two times; the right camera's keyframes come first.
fn stereo_map(right_has_other_lens: bool) -> MapContents {
    let mut contents = map();
    let baseline = Pose::new(UnitQuaternion::identity(), Vector3::new(0.1, 0.0, 0.0));
    let mut rights = contents.keyframes.clone();
    for (keyframe, right) in contents.keyframes.iter_mut().zip(&mut rights) {
        keyframe.id += 10;
        right.global_from_keyframe.pose = right.global_from_keyframe.pose.compose(&baseline);
        if right_has_other_lens {
            right.camera.focal[0] += 3.0;
        }
    }
    for landmark in &mut contents.landmarks {
        landmark.anchor += 10;
        landmark.observations.iter_mut().for_each(|seen| seen.keyframe += 10);
    }
    contents.landmarks[2].observations.truncate(1);
    contents.keyframes.splice(0..0, rights);
    contents
}

#[test]
fn the_images_of_two_cameras_have_names_of_their_own_with_the_recordings_folders() {
    for right_has_other_lens in [true, false] {
        let map = stereo_map(right_has_other_lens);
        let names = image_names(&map.keyframes, ".png");
        let expected = [
            (1, "cam1/1000000000.png"),
            (2, "cam1/2000000000.png"),
            (11, "cam0/1000000000.png"),
            (12, "cam0/2000000000.png"),
        ];
        assert_eq!(names, expected.map(|(id, name)| (id, name.to_owned())).into());

        let folder = tempfile::tempdir().unwrap();
        let written = write_model(folder.path(), &map, |keyframe| names[&keyframe.id].clone()).unwrap();
        assert_eq!(written, WrittenModel { images: 4, points: 2, seen_once: 1 });
        let model = read_model(folder.path()).unwrap();
        assert_eq!((model.images.len(), model.points.len()), (4, 2));
        assert_eq!(model.images[&1].name, "cam1/1000000000.png");
        let pixels = &model.images[&11].pixels;
        assert!(pixels.len() == 2 && pixels.iter().all(|seen| seen.point < 3), "{pixels:?}");
    }
    let mut timeless = map();
    timeless.keyframes.iter_mut().for_each(|keyframe| keyframe.stamp_ns = 0);
    let names = image_names(&timeless.keyframes, ".jpg");
    assert_eq!((names[&1].as_str(), names[&2].as_str()), ("keyframe_000001.jpg", "keyframe_000002.jpg"));
}

#[test]
fn a_name_that_two_images_have_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let error = write_model(folder.path(), &map(), |_| "a.png".to_owned()).unwrap_err();
    assert!(matches!(&error, ColmapError::SameName { name } if name == "a.png"), "{error}");
    write_model(folder.path(), &map(), |keyframe| format!("{}.png", keyframe.id)).unwrap();
    let images = folder.path().join("images.txt");
    let text = std::fs::read_to_string(&images).unwrap();
    std::fs::write(&images, text.replace("2.png", "1.png")).unwrap();
    let error = read_model(folder.path()).unwrap_err();
    assert!(matches!(&error, ReadColmapError::SameName { name } if name == "1.png"), "{error}");
}

#[test]
fn every_camera_that_colmap_has_is_read_back_and_the_others_are_named() {
    let with = |distortion: Distortion| {
        let folder = tempfile::tempdir().unwrap();
        let mut map = map();
        for keyframe in &mut map.keyframes {
            keyframe.camera.distortion = distortion;
        }
        write_model(folder.path(), &map, |keyframe| format!("{}.png", keyframe.stamp_ns))?;
        Ok(read_model(folder.path()).unwrap().cameras[&1].distortion)
    };
    for distortion in [
        Distortion::None,
        Distortion::Equidistant([0.01, -0.02, 0.003, -4e-4]),
        Distortion::Fov(0.93),
        Distortion::from_opencv(&[-0.2, 0.05, 1e-3, -7e-4, 0.01]).unwrap(),
        Distortion::from_opencv(&[-0.2, 0.05, 1e-3, -7e-4, -0.004, 0.02, 0.01, 3e-7]).unwrap(),
        Distortion::ThinPrismFisheye([-0.04, 0.01, 2e-4, -4e-4, -0.004, 8e-4, 6e-4, -9e-4]),
    ] {
        assert_eq!(with(distortion).unwrap(), distortion);
    }
    let mut prism = [0.0; 12];
    prism[8] = 1e-3;
    for (distortion, name) in [
        (Distortion::Rational(prism), "radial-tangential"),
        (Distortion::DoubleSphere { xi: -0.2, alpha: 0.57 }, "ds"),
        (Distortion::Eucm { alpha: 0.63, beta: 1.04 }, "eucm"),
        (Distortion::Omni { xi: 0.9, distortion: [0.0; 4] }, "omni"),
    ] {
        let refused: Result<Distortion, ColmapError> = with(distortion);
        assert!(matches!(&refused, Err(ColmapError::CameraModel { model }) if *model == name), "{refused:?}");
    }
}

#[test]
fn a_model_that_cannot_be_written_leaves_no_part_of_it() {
    let folder = tempfile::tempdir().unwrap();
    // In the place of what is renamed to the last file.
    let in_the_way = folder.path().join("points3D.txt.unfinished");
    std::fs::create_dir(&in_the_way).unwrap();
    let write = || write_model(folder.path(), &map(), |keyframe| keyframe.id.to_string());
    assert!(matches!(write(), Err(ColmapError::Write { path, .. }) if path.ends_with("points3D.txt")));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    std::fs::remove_dir(&in_the_way).unwrap();
    assert!(write().is_ok());
}
