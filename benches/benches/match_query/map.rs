//! A seeded synthetic map of many places with descriptors whose distances are like those of learned features.

use geometry::{Camera, Distortion, Pose, PoseWithCovariance};
use map::{Keyframe, KeyframeCrossCovariance, Landmark, MapContents, MapMetadata, Observation};
use nalgebra::{Matrix6, UnitQuaternion, Vector2, Vector3, Vector6};
use protocol::{DescriptorKind, Descriptors, FeatureSet, MatchRequest};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;

const WIDTH: usize = 64;
/// Kinds of texture in the world.
const WORDS: usize = 3000;
/// Size of what is special about a landmark, beside a word of norm 1.
const SPECIAL: f64 = 0.62;
/// Size of the noise of one view: views of one landmark are at a cosine distance of 0.13 on average.
const VIEW: f64 = 0.45;
/// Part of the landmarks that look like others: windows, tiles.
const REPEATED_SHARE: f64 = 0.15;
const REPEATED_LOOKS: usize = 400;
/// Keyframes before and after each with which it is correlated.
const CORRELATED: usize = 2;
/// Keyframes a street, 1 m apart.
const STREET: usize = 500;

pub struct World {
    pub camera: Camera,
    /// By street: where, and what it looks like.
    streets: Vec<Vec<(Vector3<f64>, Vec<f32>)>>,
    pub map: Option<MapContents>,
    /// Part of the landmarks in view that a keyframe or a query observes.
    observed_share: f64,
}

impl World {
    /// A map of `keyframes` keyframes, each of which observes a share of the 500 landmarks in its view.
    pub fn new(keyframes: usize, observed_share: f64) -> World {
        let mut rng = StdRng::seed_from_u64(7);
        let words: Vec<Vec<f32>> = (0..WORDS).map(|_| random(&mut rng, 1.0)).collect();
        let repeated: Vec<Vec<f32>> = (0..REPEATED_LOOKS).map(|_| look(&words, &mut rng)).collect();
        let camera = Camera {
            width: 752,
            height: 480,
            focal: [458.0, 457.0],
            centre: [376.0, 240.0],
            distortion: Distortion::RadialTangential([-0.28, 0.07, 0.0002, 0.00002]),
        };
        let mut world = World { camera, streets: Vec::new(), map: None, observed_share };
        let mut info = MapMetadata::new("bench", "bench", DescriptorKind::Int8, WIDTH as u16);
        info.gravity_in_global = Some(Vector3::new(0.0, 0.0, -1.0));
        let mut map = MapContents::empty(info);
        let sigmas = Vector6::new(0.002, 0.002, 0.002, 0.01, 0.01, 0.01);
        let covariance = Matrix6::from_diagonal(&sigmas.component_mul(&sigmas));
        for street in 0..keyframes.div_ceil(STREET) {
            let count = STREET.min(keyframes - street * STREET);
            let points = (0..count * 52).map(|_| {
                let side = if rng.random_bool(0.5) { 1.0 } else { -1.0 };
                let position = Vector3::new(
                    rng.random_range(0.0..count as f64 + 12.0),
                    side * rng.random_range(2.0..7.0),
                    rng.random_range(-1.5..4.0),
                );
                let look = if rng.random_bool(REPEATED_SHARE) {
                    repeated[rng.random_range(0..REPEATED_LOOKS)].clone()
                } else {
                    look(&words, &mut rng)
                };
                (position, look)
            });
            world.streets.push(points.collect());
            let mut observations: Vec<Vec<Observation>> = vec![Vec::new(); world.streets[street].len()];
            for along in 0..count {
                let id = (street * STREET + along) as u64;
                let truth = World::camera_at(street, along as f64, 0.0, 0.0);
                for (point, pixel) in world.see(street, &truth, 0.7, &mut rng) {
                    if rng.random_bool(observed_share) {
                        let descriptor = view(&world.streets[street][point].1, &mut rng);
                        observations[point].push(Observation { keyframe: id, pixel, descriptor });
                    }
                }
                let error = Vector6::from_fn(|row, _| normal(&mut rng) * sigmas[row]);
                map.keyframes.push(Keyframe {
                    id,
                    stamp_ns: id as i64,
                    global_from_keyframe: PoseWithCovariance::new(truth.retract(&error), covariance),
                    camera: world.camera.clone(),
                    features: None,
                });
                let block = covariance * 0.3;
                map.cross_covariances.extend((along.saturating_sub(CORRELATED)..along).map(|other| {
                    KeyframeCrossCovariance { a: (street * STREET + other) as u64, b: id, block }
                }));
            }
            for (point, observations) in observations.into_iter().enumerate() {
                if observations.len() < 2 {
                    continue;
                }
                let anchor = observations[0].keyframe;
                let pose = World::camera_at(street, (anchor as usize % STREET) as f64, 0.0, 0.0);
                let position = pose.inverse_transform(&(world.streets[street][point].0 + beside(street)));
                map.landmarks.push(Landmark {
                    id: (street * 1_000_000 + point) as u64,
                    anchor,
                    position_in_anchor: position * (1.0 + 0.003 * normal(&mut rng)),
                    observations,
                });
            }
        }
        world.map = Some(map);
        world
    }

    pub fn camera_at(street: usize, x: f64, y: f64, yaw: f64) -> Pose {
        let level_from_camera = UnitQuaternion::from_euler_angles(0.0, 0.0, yaw)
            * UnitQuaternion::from_euler_angles(
                -std::f64::consts::FRAC_PI_2,
                0.0,
                -std::f64::consts::FRAC_PI_2,
            );
        Pose::new(level_from_camera, Vector3::new(x, y, 1.0) + beside(street))
    }

    fn see(
        &self,
        street: usize,
        global_from_camera: &Pose,
        sigma: f64,
        rng: &mut StdRng,
    ) -> Vec<(usize, [f32; 2])> {
        let mut seen = Vec::new();
        let points = &self.streets[street];
        for (index, (point, _)) in points.iter().enumerate() {
            let in_camera = global_from_camera.inverse_transform(&(point + beside(street)));
            if in_camera.z < 1.0 || in_camera.norm() > 15.0 || in_camera.xy().norm() > 1.1 * in_camera.z {
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

    /// A query of 500 features: at most `of_the_place` of the street, the others clutter of the same kinds of texture.
    pub fn query(&self, street: usize, pose: &Pose, of_the_place: usize, rng: &mut StdRng) -> MatchRequest {
        let (mut pixels, mut bytes) = (Vec::new(), Vec::new());
        for (point, pixel) in self.see(street, pose, 0.7, rng) {
            if pixels.len() < of_the_place && rng.random_bool(self.observed_share) {
                pixels.push(pixel);
                bytes.extend(view(&self.streets[street][point].1, rng));
            }
        }
        while pixels.len() < 500 {
            pixels.push([rng.random_range(0.0..751.0), rng.random_range(0.0..479.0)]);
            // Texture like that of the map, of a landmark that is nowhere near.
            let other = &self.streets[rng.random_range(0..self.streets.len())];
            let alike = &other[rng.random_range(0..other.len())].1;
            let mixed: Vec<f32> = alike.iter().zip(random(rng, 0.8)).map(|(x, y)| x + y).collect();
            bytes.extend(view(&mixed, rng));
        }
        let descriptors = Descriptors { kind: DescriptorKind::Int8, width: WIDTH as u16, bytes };
        MatchRequest {
            robot: "bench".to_owned(),
            stamp_ns: 0,
            camera: self.camera.clone(),
            features: FeatureSet { pixels, descriptors, extractor: String::new() },
            prior: None,
            gravity_in_camera: None,
            held: Vec::new(),
            map_version_held: None,
            max_keyframes: 3,
        }
    }
}

/// Where a street begins (m).
fn beside(street: usize) -> Vector3<f64> {
    Vector3::new(0.0, 100.0 * street as f64, 0.0)
}

fn look(words: &[Vec<f32>], rng: &mut StdRng) -> Vec<f32> {
    let word = &words[rng.random_range(0..words.len())];
    word.iter().zip(random(rng, SPECIAL)).map(|(x, y)| x + y).collect()
}

fn view(look: &[f32], rng: &mut StdRng) -> Vec<u8> {
    let norm = look.iter().map(|x| x * x).sum::<f32>().sqrt();
    let seen: Vec<f32> = look.iter().zip(random(rng, VIEW)).map(|(x, y)| x / norm + y).collect();
    let norm = seen.iter().map(|x| x * x).sum::<f32>().sqrt();
    seen.iter().map(|x| ((x / norm * 300.0).round().clamp(-127.0, 127.0) as i8).cast_unsigned()).collect()
}

/// A random vector of about the given norm.
fn random(rng: &mut StdRng, norm: f64) -> Vec<f32> {
    (0..WIDTH).map(|_| (normal(rng) * norm / (WIDTH as f64).sqrt()) as f32).collect()
}

pub fn normal(rng: &mut StdRng) -> f64 {
    rng.sample(StandardNormal)
}
