//! A map server and its client in one process: builds a small map, serves it on the loopback interface, and asks where
//! an image was taken.
//!
//! ```text
//! cargo run -p driftless-map-server --example embedded [-- MAP.db]
//! ```
//! With a database as argument, that map is served and only its properties are printed.

use std::sync::Arc;
use std::time::{Duration, Instant};

use client::{MapClient, SessionOptions, close_session, open_session};
use geometry::{Camera, Distortion, Pose, PoseWithCovariance};
use map::{Keyframe, Landmark, MapContents, MapMetadata, Observation};
use map_server::{MapServer, ServedMap, ServerOptions};
use nalgebra::{Matrix6, UnitQuaternion, Vector2, Vector3};
use protocol::{DescriptorKind, Descriptors, FeatureSet, LocalizeRequest};
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};
use recognition::LoadedMap;

type Error = Box<dyn std::error::Error + Send + Sync>;

/// Bytes of a binary descriptor.
const DESCRIPTOR_BYTES: u16 = 32;

#[tokio::main]
async fn main() -> Result<(), Error> {
    let database = std::env::args().nth(1);
    let scene = Scene::new(&mut StdRng::seed_from_u64(1));
    let map = match &database {
        Some(path) => LoadedMap::read(path)?,
        None => LoadedMap::from_contents(scene.map())?,
    };

    // The server: a session that listens, and the map in it.
    let port = std::net::TcpListener::bind("127.0.0.1:0")?.local_addr()?.port();
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let options = SessionOptions { listen: vec![endpoint.clone()], ..SessionOptions::default() };
    let serving = open_session(&options).await?;
    let maps = vec![ServedMap { name: "hall".to_owned(), map: Arc::new(map) }];
    let server = MapServer::start(serving.clone(), maps, ServerOptions::default()).await?;

    // The client: usually another process. The first query is repeated until the sessions are connected.
    let options = SessionOptions { connect: vec![endpoint], ..SessionOptions::default() };
    let session = open_session(&options).await?;
    let hall = MapClient::new(session.clone(), "hall")?;
    let deadline = Instant::now() + Duration::from_secs(10);
    let info = hall.info(deadline).await?;
    println!("map {}: {} keyframes, {} landmarks", info.name, info.keyframes, info.landmarks);
    if database.is_none() {
        let truth = Scene::camera_at(7.3, 0.4);
        let reply = hall.localize(&scene.request(&truth), deadline).await?;
        let fix = reply.fix.ok_or("the image was not recognized")?;
        let (p, t) = (fix.global_from_camera.pose.translation, truth.translation);
        println!("camera at ({:.3}, {:.3}, {:.3}) m from {} inliers", p.x, p.y, p.z, fix.inliers);
        println!("truth     ({:.3}, {:.3}, {:.3}) m", t.x, t.y, t.z);
    }

    close_session(&session).await;
    server.stop().await?;
    close_session(&serving).await;
    Ok(())
}

/// A corridor along x with landmarks on both sides.
struct Scene {
    camera: Camera,
    /// Position in the global frame (m) and descriptor of each landmark.
    landmarks: Vec<(Vector3<f64>, Vec<u8>)>,
}

impl Scene {
    fn new(rng: &mut StdRng) -> Scene {
        let camera = Camera {
            width: 752,
            height: 480,
            focal: [458.0; 2],
            centre: [375.5, 239.5],
            distortion: Distortion::None,
        };
        let mut landmark = || {
            let side = if rng.random_bool(0.5) { 1.0 } else { -1.0 };
            let position = Vector3::new(
                rng.random_range(0.0..40.0),
                side * rng.random_range(2.0..8.0),
                rng.random_range(-1.0..4.0),
            );
            let descriptor = (0..DESCRIPTOR_BYTES).map(|_| rng.random()).collect();
            (position, descriptor)
        };
        let landmarks = (0..600).map(|_| landmark()).collect();
        Scene { camera, landmarks }
    }

    /// A camera that looks along x, 1 m above the ground.
    fn camera_at(x: f64, y: f64) -> Pose {
        let quarter = std::f64::consts::FRAC_PI_2;
        Pose::new(UnitQuaternion::from_euler_angles(-quarter, 0.0, -quarter), Vector3::new(x, y, 1.0))
    }

    /// Index and pixel of the landmarks that a camera sees.
    fn visible(&self, global_from_camera: &Pose) -> Vec<(usize, Vector2<f64>)> {
        let project = |(index, (position, _)): (usize, &(Vector3<f64>, Vec<u8>))| {
            let pixel = self.camera.project(&global_from_camera.inverse_transform(position)).ok()?;
            let inside = (0.0..752.0).contains(&pixel.x) && (0.0..480.0).contains(&pixel.y);
            inside.then_some((index, pixel))
        };
        self.landmarks.iter().enumerate().filter_map(project).collect()
    }

    /// A map of twelve keyframes. Each landmark is anchored in the first keyframe that sees it.
    fn map(&self) -> MapContents {
        let mut contents =
            MapContents::empty(MapMetadata::new("hall", "example", DescriptorKind::Binary, DESCRIPTOR_BYTES));
        contents.info.gravity_in_global = Some(-Vector3::z());
        let mut observed = vec![Vec::new(); self.landmarks.len()];
        for id in 0..12 {
            let pose = Self::camera_at(2.0 * id as f64, 0.0);
            for (index, pixel) in self.visible(&pose) {
                observed[index].push((id, pose, pixel));
            }
            contents.keyframes.push(Keyframe {
                id,
                stamp_ns: 1_000_000_000 * id as i64,
                global_from_keyframe: PoseWithCovariance::new(pose, Matrix6::identity() * 1e-4),
                camera: self.camera.clone(),
                features: None,
            });
        }
        for (id, (observations, (position, descriptor))) in observed.iter().zip(&self.landmarks).enumerate() {
            let Some((anchor, pose, _)) = observations.first() else { continue };
            contents.landmarks.push(Landmark {
                id: id as u64,
                anchor: *anchor,
                position_in_anchor: pose.inverse_transform(position),
                observations: observations
                    .iter()
                    .map(|(keyframe, _, pixel)| Observation {
                        keyframe: *keyframe,
                        pixel: [pixel.x as f32, pixel.y as f32],
                        descriptor: descriptor.clone(),
                    })
                    .collect(),
            });
        }
        contents
    }

    /// The query of an image taken at a pose.
    fn request(&self, global_from_camera: &Pose) -> LocalizeRequest {
        let visible = self.visible(global_from_camera);
        let bytes = visible.iter().flat_map(|(index, _)| self.landmarks[*index].1.clone()).collect();
        let descriptors = Descriptors { kind: DescriptorKind::Binary, width: DESCRIPTOR_BYTES, bytes };
        let pixels = visible.iter().map(|(_, pixel)| [pixel.x as f32, pixel.y as f32]).collect();
        LocalizeRequest {
            camera: self.camera.clone(),
            features: FeatureSet { pixels, descriptors, extractor: String::new() },
            prior: None,
            gravity_in_camera: None,
        }
    }
}
