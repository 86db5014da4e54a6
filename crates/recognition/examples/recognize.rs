//! Builds a map of a small synthetic place in memory and localizes an image in it.
//!
//! `cargo run -p driftless-recognition --example recognize`

use geometry::uncertain_pose::isotropic_covariance;
use geometry::{Camera, Distortion, Pose, PoseWithCovariance};
use map::{Keyframe, Landmark, MapContents, MapMetadata, Observation};
use nalgebra::{UnitQuaternion, Vector3};
use protocol::{DescriptorKind, Descriptors, FeatureSet, LocalizeRequest};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use recognition::{LoadedMap, RecognitionOptions};

/// A binary descriptor of 256 bits, as ORB computes them.
const DESCRIPTOR_BYTES: usize = 32;

/// A landmark of the place: its position in G (m) and its descriptor.
struct Point {
    position: Vector3<f64>,
    descriptor: [u8; DESCRIPTOR_BYTES],
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut rng = StdRng::seed_from_u64(1);
    let camera = Camera {
        width: 640,
        height: 480,
        focal: [400.0, 400.0],
        centre: [319.5, 239.5],
        distortion: Distortion::None,
    };
    let place: Vec<Point> = (0..600)
        .map(|_| Point {
            position: Vector3::new(
                rng.random_range(-4.0..14.0),
                rng.random_range(-3.0..3.0),
                rng.random_range(4.0..9.0),
            ),
            descriptor: rng.random(),
        })
        .collect();
    let map = LoadedMap::from_contents(survey(&place, &camera))?;
    println!("a map of {} keyframes and {} landmarks", map.keyframe_count(), map.landmark_count());

    // An image between two keyframes, a bit further back, with pixel noise and flipped descriptor bits.
    let rotation = UnitQuaternion::from_euler_angles(0.02, 0.1, -0.03);
    let truth = Pose::new(rotation, Vector3::new(4.6, 0.2, -0.5));
    let mut features = FeatureSet {
        pixels: Vec::new(),
        descriptors: Descriptors {
            kind: DescriptorKind::Binary,
            width: DESCRIPTOR_BYTES as u16,
            bytes: Vec::new(),
        },
        extractor: String::new(),
    };
    for (point, [u, v]) in visible(&place, &camera, &truth) {
        features.pixels.push([u + rng.random_range(-1.0..1.0), v + rng.random_range(-1.0..1.0)]);
        let mut descriptor = place[point].descriptor;
        descriptor[rng.random_range(0..DESCRIPTOR_BYTES)] ^= 1 << rng.random_range(0..8);
        features.descriptors.bytes.extend(descriptor);
    }

    println!("keyframes by appearance: {:?}", map.rank_keyframes(&features, 3)?);
    let request = LocalizeRequest { camera, features, prior: None, gravity_in_camera: None };
    let reply = map.localize(&request, &RecognitionOptions::default())?;
    let Some(fix) = reply.fix else {
        return Err(format!("not recognized: {:?}", reply.outcome).into());
    };
    let estimate = &fix.global_from_camera;
    let sigmas = estimate.covariance.diagonal().map(f64::sqrt);
    println!("best keyframe {}: {} inliers of {}", fix.keyframe, fix.inliers, fix.matched_features);
    println!("position (m)            {:.3?}", estimate.pose.translation.as_slice());
    println!("true position (m)       {:.3?}", truth.translation.as_slice());
    println!("sigma of rotation (rad) {:.5?}", &sigmas.as_slice()[..3]);
    println!("sigma of position (m)   {:.4?}", &sigmas.as_slice()[3..]);
    Ok(())
}

/// The points that a camera observes, with their pixels.
fn visible(place: &[Point], camera: &Camera, global_from_camera: &Pose) -> Vec<(usize, [f32; 2])> {
    let pixel = |(index, point): (usize, &Point)| {
        let pixel = camera.project(&global_from_camera.inverse_transform(&point.position)).ok()?;
        camera.contains(&pixel).then_some((index, [pixel.x as f32, pixel.y as f32]))
    };
    place.iter().enumerate().filter_map(pixel).collect()
}

/// Maps the place from keyframes every 2 m along x, whose poses are known to 0.005 rad and 0.02 m.
fn survey(place: &[Point], camera: &Camera) -> MapContents {
    let metadata =
        MapMetadata::new("place", "example recognize", DescriptorKind::Binary, DESCRIPTOR_BYTES as u16);
    let mut contents = MapContents::empty(metadata);
    let mut observations: Vec<Vec<Observation>> = place.iter().map(|_| Vec::new()).collect();
    for id in 0..6 {
        let pose = Pose::new(UnitQuaternion::identity(), Vector3::new(2.0 * id as f64, 0.0, 0.0));
        for (point, pixel) in visible(place, camera, &pose) {
            let descriptor = place[point].descriptor.to_vec();
            observations[point].push(Observation { keyframe: id, pixel, descriptor });
        }
        contents.keyframes.push(Keyframe {
            id,
            stamp_ns: 0,
            global_from_keyframe: PoseWithCovariance::new(pose, isotropic_covariance(0.005, 0.02)),
            camera: camera.clone(),
            features: None,
        });
    }
    for (id, (point, observations)) in (0..).zip(place.iter().zip(observations)) {
        let Some(first) = observations.first() else { continue };
        let anchor = first.keyframe;
        let global_from_anchor = &contents.keyframes[anchor as usize].global_from_keyframe.pose;
        let position_in_anchor = global_from_anchor.inverse_transform(&point.position);
        contents.landmarks.push(Landmark { id, anchor, position_in_anchor, observations });
    }
    contents
}
