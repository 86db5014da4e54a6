//! A seeded synthetic place for tests: keyframes along a path, landmarks around it, and images taken along it.
#![allow(clippy::unwrap_used, clippy::missing_panics_doc, missing_docs)]

mod folders;
mod made_once;
mod memory;

pub use folders::copy_folder;
pub use made_once::made_once;
pub use memory::resident_mb;

use geometry::uncertain_pose::isotropic_covariance;
use geometry::{Camera, Distortion, Pose, PoseWithCovariance};
use map::{
    AddedFeatures, Alias, CommonError, FeatureKind, KeptImage, Keyframe, KeyframeAliases,
    KeyframeCrossCovariance, Landmark, LandmarkExistence, MapContents, MapMetadata, Observation,
};
use nalgebra::{Matrix6xX, UnitQuaternion, Vector2, Vector3, Vector6};
use protocol::{DescriptorKind, Descriptors, FeatureSet, MatchRequest};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};

pub const DESCRIPTOR_BYTES: usize = 32;
/// Standard deviations of a keyframe's pose.
pub const SIGMA_THETA: f64 = 0.005;
pub const SIGMA_P: f64 = 0.02;

/// Adds common errors of so many columns to the keyframes of a place: a quarter of their variance at most.
pub fn add_common_errors(map: &mut MapContents, columns: usize) {
    let part = (0.04 / columns as f64).sqrt();
    map.common_errors = map
        .keyframes
        .iter()
        .map(|keyframe| {
            let sigmas = keyframe.global_from_keyframe.covariance.diagonal().map(f64::sqrt);
            let sign = |row: usize, column: usize| {
                let phase = (keyframe.id * (column as u64 + 1)) as usize / 7 + row * (column + 2);
                if phase.is_multiple_of(3) { -1.0 } else { 1.0 }
            };
            let factor = Matrix6xX::from_fn(columns, |row, column| part * sigmas[row] * sign(row, column));
            CommonError { keyframe: keyframe.id, factor }
        })
        .collect();
    map.sort();
    map.info.identity = Some(map.digest());
}

/// Adds aliases to the keyframes of a place: every third one could be taken for its second next one.
pub fn add_aliases(map: &mut MapContents) {
    map.sort();
    let ids: Vec<u64> = map.keyframes.iter().map(|keyframe| keyframe.id).collect();
    let places = |at: usize| {
        let other = ids.get(at + 2).filter(|_| at.is_multiple_of(3));
        other.map(|&keyframe| Alias { keyframe, log_odds: 0.25 * at as f64 - 1.0 }).into_iter().collect()
    };
    map.aliases =
        (0..ids.len()).map(|at| KeyframeAliases { keyframe: ids[at], places: places(at) }).collect();
    map.info.identity = Some(map.digest());
}

/// Adds features of a second kind: copies of every second landmark, which other descriptors tell, see [`second_descriptor`].
pub fn add_second_kind(map: &mut MapContents, extractor: &str) {
    map.sort();
    let last =
        map.landmarks_of_kinds().flat_map(|(_, landmarks)| landmarks).map(|landmark| landmark.id).max();
    let copy = |(id, landmark): (u64, &Landmark)| {
        let mut copy = Landmark { id, ..landmark.clone() };
        copy.observations.iter_mut().for_each(|seen| second_descriptor(&mut seen.descriptor));
        copy
    };
    let landmarks = (last.unwrap_or(0) + 1..).zip(map.landmarks.iter().step_by(2)).map(copy).collect();
    let kind = FeatureKind { extractor: extractor.to_owned(), sigma_px: 1.5, ..map.info.feature_kind() };
    map.added_features.push(AddedFeatures { kind, landmarks });
}

/// What the extractor of the second kind makes of what the first one describes.
pub fn second_descriptor(descriptor: &mut [u8]) {
    for byte in descriptor {
        *byte = byte.rotate_left(3) ^ 0x5a;
    }
}

/// Adds images to every keyframe but the first: no real ones, but of the first bytes of JPEG files.
pub fn add_images(map: &mut MapContents) {
    map.sort();
    let image = |keyframe: &Keyframe| {
        let noise = (0..700 + keyframe.id % 50).map(|at| (at * (keyframe.id + 3) % 251) as u8);
        KeptImage { keyframe: keyframe.id, jpeg: [0xff, 0xd8].into_iter().chain(noise).collect() }
    };
    map.images = map.keyframes.iter().skip(1).map(image).collect();
}

/// States the existence of every third landmark of a place.
pub fn add_existence(map: &mut MapContents) {
    map.sort();
    let existence = |(at, landmark): (usize, &Landmark)| LandmarkExistence {
        landmark: landmark.id,
        log_odds: 4.0 - 0.25 * (at % 20) as f64,
        stamp_ns: 1_700_000_000_000_000_000 + at as i64,
        seen_ns: 1_600_000_000_000_000_000 + at as i64,
    };
    map.existence = map.landmarks.iter().enumerate().step_by(3).map(existence).collect();
    map.info.identity = Some(map.digest());
}

/// Landmarks of a poster, see [`PlaceOptions::posters`].
pub const POSTER_LANDMARKS: usize = 80;

/// How a place is made.
#[derive(Clone, Debug)]
pub struct PlaceOptions {
    pub seed: u64,
    pub keyframes: usize,
    pub landmarks: usize,
    /// How many different descriptors the repeated texture has; 0: none is repeated.
    pub repeated_descriptors: usize,
    /// Part of the landmarks that have repeated texture.
    pub repeated_share: f64,
    /// Pictures of [`POSTER_LANDMARKS`] landmarks each, 1.6 m long and 1.2 m high, on both sides of the path by turns; their
    /// landmarks come after the others.
    pub posters: usize,
    /// G is turned against the vertical, as in one of the recorded places.
    pub turned: bool,
    pub gravity_known: bool,
}

impl Default for PlaceOptions {
    fn default() -> PlaceOptions {
        PlaceOptions {
            seed: 1,
            keyframes: 30,
            landmarks: 1500,
            repeated_descriptors: 0,
            repeated_share: 0.0,
            posters: 0,
            turned: true,
            gravity_known: true,
        }
    }
}

/// The truth about a place, and the noisy map of it.
pub struct Place {
    pub camera: Camera,
    /// Unit vector downwards, in G.
    pub gravity: Vector3<f64>,
    /// True landmark positions in G and their descriptors.
    pub points: Vec<(Vector3<f64>, Vec<u8>)>,
    /// True keyframe poses.
    pub path: Vec<Pose>,
    pub map: MapContents,
    global_from_level: UnitQuaternion<f64>,
}

pub fn camera() -> Camera {
    Camera {
        width: 752,
        height: 480,
        focal: [458.0, 457.0],
        centre: [376.0, 240.0],
        distortion: Distortion::RadialTangential([-0.28, 0.07, 0.0002, 0.00002]),
    }
}

impl Place {
    pub fn new(options: &PlaceOptions) -> Place {
        let mut rng = StdRng::seed_from_u64(options.seed);
        let global_from_level = if options.turned {
            UnitQuaternion::from_scaled_axis(Vector3::new(0.3, -1.1, 0.6))
        } else {
            UnitQuaternion::identity()
        };
        let length = 2.0 * options.keyframes as f64;
        let texture: Vec<Vec<u8>> = (0..options.repeated_descriptors).map(|_| descriptor(&mut rng)).collect();
        let mut points: Vec<(Vector3<f64>, Vec<u8>)> = (0..options.landmarks)
            .map(|_| {
                let level = Vector3::new(
                    rng.random_range(-5.0..length + 30.0),
                    rng.random_range(3.0..15.0) * if rng.random_bool(0.5) { 1.0 } else { -1.0 },
                    rng.random_range(-2.0..6.0),
                );
                let repeated = !texture.is_empty() && rng.random_bool(options.repeated_share);
                let descriptor = if repeated {
                    texture[rng.random_range(0..texture.len())].clone()
                } else {
                    descriptor(&mut rng)
                };
                (global_from_level * level, descriptor)
            })
            .collect();
        for poster in 0..options.posters {
            let (x, y) = (4.0 * poster as f64, if poster % 2 == 0 { 4.0 } else { -4.0 });
            points.extend((0..POSTER_LANDMARKS).map(|_| {
                let level =
                    Vector3::new(x + rng.random_range(0.0..1.6), y, 1.0 + rng.random_range(-0.6..0.6));
                (global_from_level * level, descriptor(&mut rng))
            }));
        }
        let mut place = Place {
            camera: camera(),
            gravity: global_from_level * Vector3::new(0.0, 0.0, -1.0),
            points,
            path: Vec::new(),
            map: MapContents::empty(MapMetadata::new("place", "test", DescriptorKind::Binary, 32)),
            global_from_level,
        };
        place.path = (0..options.keyframes).map(|i| place.camera_at(2.0 * i as f64, 0.0, 0.0)).collect();
        place.build_map(options, &mut rng);
        place
    }

    /// The camera at `x` along and `y` beside the path, heading `yaw` off it.
    pub fn camera_at(&self, x: f64, y: f64, yaw: f64) -> Pose {
        // The camera's z forward, x right, y down, on a level x forward, y left, z up.
        let level_from_camera = UnitQuaternion::from_euler_angles(0.0, 0.0, yaw)
            * UnitQuaternion::from_euler_angles(
                -std::f64::consts::FRAC_PI_2,
                0.0,
                -std::f64::consts::FRAC_PI_2,
            );
        Pose::new(
            self.global_from_level * level_from_camera,
            self.global_from_level * Vector3::new(x, y, 1.0),
        )
    }

    /// Which points a camera sees, where, with pixel noise of `sigma`.
    pub fn see(&self, global_from_camera: &Pose, sigma: f64, rng: &mut StdRng) -> Vec<(usize, [f32; 2])> {
        let mut seen = Vec::new();
        for (index, (point, _)) in self.points.iter().enumerate() {
            let in_camera = global_from_camera.inverse_transform(point);
            if in_camera.z < 1.0 || in_camera.norm() > 30.0 || in_camera.xy().norm() > 1.1 * in_camera.z {
                continue;
            }
            if let Ok(pixel) = self.camera.project(&in_camera) {
                let noisy = pixel + Vector2::new(normal(rng), normal(rng)) * sigma;
                if self.camera.contains(&noisy) {
                    seen.push((index, [noisy.x as f32, noisy.y as f32]));
                }
            }
        }
        seen
    }

    fn build_map(&mut self, options: &PlaceOptions, rng: &mut StdRng) {
        let info = &mut self.map.info;
        info.gravity_in_global = options.gravity_known.then_some(self.gravity);
        let covariance = isotropic_covariance(SIGMA_THETA, SIGMA_P);
        let mut observations: Vec<Vec<Observation>> = vec![Vec::new(); self.points.len()];
        for (index, truth) in self.path.clone().into_iter().enumerate() {
            let id = 10 + index as u64;
            for (point, pixel) in self.see(&truth, 0.5, rng) {
                let descriptor = flipped(&self.points[point].1, 0.03, rng);
                observations[point].push(Observation { keyframe: id, pixel, descriptor });
            }
            let error = Vector6::from_fn(|row, _| normal(rng) * if row < 3 { SIGMA_THETA } else { SIGMA_P });
            self.map.keyframes.push(Keyframe {
                id,
                stamp_ns: 1_000_000_000 * index as i64,
                global_from_keyframe: PoseWithCovariance::new(truth.retract(&error), covariance),
                camera: self.camera.clone(),
                features: None,
            });
        }
        for (point, observations) in observations.into_iter().enumerate() {
            let Some(first) = observations.first() else { continue };
            let anchor = first.keyframe;
            let position = self.path[(anchor - 10) as usize].inverse_transform(&self.points[point].0);
            self.map.landmarks.push(Landmark {
                id: 1000 + point as u64,
                anchor,
                position_in_anchor: position * (1.0 + 0.01 * normal(rng)),
                observations,
            });
        }
        for pair in self.map.keyframes.windows(2) {
            let (a, b) = (pair[0].id, pair[1].id);
            self.map.cross_covariances.push(KeyframeCrossCovariance { a, b, block: covariance * 0.4 });
        }
        self.map.sort();
        // Changed versions of it are versions of the same map.
        self.map.info.identity = Some(self.map.digest());
    }

    /// The features that an extractor sees from a pose: points with flipped bits, and clutter.
    pub fn features(&self, global_from_camera: &Pose, clutter: usize, rng: &mut StdRng) -> FeatureSet {
        let mut pixels = Vec::new();
        let mut bytes = Vec::new();
        for (point, pixel) in self.see(global_from_camera, 0.7, rng) {
            pixels.push(pixel);
            bytes.extend(flipped(&self.points[point].1, 0.05, rng));
        }
        for _ in 0..clutter {
            pixels.push([rng.random_range(0.0..751.0), rng.random_range(0.0..479.0)]);
            bytes.extend(descriptor(rng));
        }
        let width = DESCRIPTOR_BYTES as u16;
        let descriptors = Descriptors { kind: DescriptorKind::Binary, width, bytes };
        FeatureSet { pixels, descriptors, extractor: String::new() }
    }

    /// A query without prior and gravity.
    pub fn request(&self, global_from_camera: &Pose, max_keyframes: u16, rng: &mut StdRng) -> MatchRequest {
        MatchRequest {
            robot: "test_robot".to_owned(),
            stamp_ns: 5,
            camera: self.camera.clone(),
            features: self.features(global_from_camera, 60, rng),
            prior: None,
            gravity_in_camera: None,
            held: Vec::new(),
            map_version_held: None,
            max_keyframes,
        }
    }
}

/// Adds a copy of a map's keyframes and landmarks to it, so far from them in G (m): another place that looks alike.
///
/// # Arguments
/// * `further`: what the ids of keyframes and of landmarks are larger by.
pub fn add_copy_beside(map: &mut MapContents, beside: Vector3<f64>, further: [u64; 2]) {
    let [of_keyframes, of_landmarks] = further;
    for mut keyframe in map.keyframes.clone() {
        keyframe.id += of_keyframes;
        keyframe.global_from_keyframe.pose.translation += beside;
        map.keyframes.push(keyframe);
    }
    for mut landmark in map.landmarks.clone() {
        landmark.id += of_landmarks;
        landmark.anchor += of_keyframes;
        landmark.observations.iter_mut().for_each(|observation| observation.keyframe += of_keyframes);
        map.landmarks.push(landmark);
    }
}

/// A random 256-bit descriptor.
pub fn descriptor(rng: &mut StdRng) -> Vec<u8> {
    (0..DESCRIPTOR_BYTES).map(|_| rng.random::<u8>()).collect()
}

/// The same descriptor with each bit flipped with a probability.
pub fn flipped(descriptor: &[u8], probability: f64, rng: &mut StdRng) -> Vec<u8> {
    let flips = |rng: &mut StdRng| {
        (0..8).fold(0u8, |byte, bit| byte | (u8::from(rng.random_bool(probability)) << bit))
    };
    descriptor.iter().map(|byte| byte ^ flips(rng)).collect()
}

/// A standard normal number.
pub fn normal(rng: &mut StdRng) -> f64 {
    StandardNormal.sample(rng)
}
