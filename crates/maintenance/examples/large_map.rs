//! What it costs to work a session of 60 s into a large map: one block of a simulated town, and copies of it with other descriptors.
//!
//! ```sh
//! cargo run -p driftless-maintenance --example large_map -- make town.db 10000
//! cargo run -p driftless-maintenance --example large_map -- maintain town.db
//! ```
//! The second line prints the time and memory of the whole program: the map is read, the session worked in, the next version written.

use std::error::Error;
use std::path::Path;
use std::time::Instant;

use maintenance::{Settings, take_session};
use map::store::{MapTarget, load_map, save_map};
use map::{CommonError, KeyframeAliases, MapContents};
use mapping::{BuildOptions, PosePriors, build_map_from_odometry, run_odometry};
use nalgebra::{Matrix6xX, Vector3};
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};
use simulation::{ChangingPlace, SimulationOptions};

const FIRST_NS: i64 = 1_700_000_000_000_000_000;
const DAY_NS: i64 = 86_400_000_000_000;
/// From a copy to the next one (m).
const APART_M: f64 = 300.0;
/// Keyframes for each of which a map that large has 6 columns of common errors, as `build-map` states them.
const KEYFRAMES_AN_ANCHOR: usize = 64;
/// Standard deviation of a common error along an axis (rad, m).
const SIGMA_COMMON: f64 = 1e-4;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["make", path, keyframes] => make(Path::new(path), keyframes.parse()?),
        ["maintain", path] => maintain(Path::new(path)),
        _ => Err("large_map make DB KEYFRAMES, or large_map maintain DB".into()),
    }
}

/// A block of a town, 60 s at 2 m/s.
fn place() -> Result<ChangingPlace, Box<dyn Error>> {
    let options = SimulationOptions {
        speed: 2.0,
        duration_s: Some(60.0),
        live_feature_period_s: 0.5,
        max_features: 250,
        dropout_fraction: 0.0,
        ..SimulationOptions::default()
    };
    Ok(ChangingPlace::new(&options)?)
}

fn make(path: &Path, keyframes: usize) -> Result<(), Box<dyn Error>> {
    let mut first = place()?.record(100_000, FIRST_NS)?;
    let odometry = run_odometry(&mut first, 2, |_, _| {})?;
    let (options, none) = (BuildOptions::default(), PosePriors::default());
    let (block, _) = build_map_from_odometry(&first, &odometry, &none, None, &options, &mut |_, _, _| {})?;
    let copies = keyframes.div_ceil(block.keyframes.len());
    let mut town = MapContents::empty(block.info.clone());
    for copy in 0..copies {
        add_copy(&mut town, &block, copy as u64, copies, keyframes);
    }
    let alone = |keyframe: &map::Keyframe| KeyframeAliases { keyframe: keyframe.id, places: Vec::new() };
    town.aliases = town.keyframes.iter().map(alone).collect();
    town.info.sessions.clear();
    town.ensure_sessions("town");
    town.sort();
    save_map(path, &town, true)?;
    println!("{} keyframes, {} landmarks", town.keyframes.len(), town.landmarks.len());
    Ok(())
}

/// Adds a block beside those before, with descriptors of its own but for the first.
fn add_copy(town: &mut MapContents, block: &MapContents, copy: u64, copies: usize, keyframes: usize) {
    let ids = |contents: &MapContents| {
        let keyframe = contents.keyframes.iter().map(|keyframe| keyframe.id).max().unwrap_or_default();
        let landmark = contents.landmarks.iter().map(|landmark| landmark.id).max().unwrap_or_default();
        (1 + keyframe, 1 + landmark)
    };
    let (keyframe_ids, landmark_ids) = ids(block);
    let (keyframe_id, landmark_id) = (copy * keyframe_ids, copy * landmark_ids);
    let side = (copies as f64).sqrt().ceil() as u64;
    let shift = Vector3::new((copy % side) as f64, (copy / side) as f64, 0.0) * APART_M;
    // What is common to the keyframes of one copy, and to those of all.
    let columns = 6 * keyframes.div_ceil(KEYFRAMES_AN_ANCHOR);
    let mut rng = StdRng::seed_from_u64(copy);
    let factor = Matrix6xX::from_fn(columns, |_, _| {
        rng.random_range(-1.0..1.0) * SIGMA_COMMON * (3.0 / columns as f64).sqrt()
    });
    for of_block in &block.keyframes {
        let mut keyframe = of_block.clone();
        keyframe.id += keyframe_id;
        keyframe.stamp_ns += copy as i64;
        let pose = &mut keyframe.global_from_keyframe;
        pose.pose.translation += shift;
        pose.covariance += &factor * factor.transpose();
        town.common_errors.push(CommonError { keyframe: keyframe.id, factor: factor.clone() });
        town.keyframes.push(keyframe);
    }
    for of_block in &block.landmarks {
        let mut landmark = of_block.clone().with_higher_ids(keyframe_id, landmark_id);
        let other: Vec<u8> = (0..32).map(|_| if copy == 0 { 0 } else { rng.random() }).collect();
        for seen in &mut landmark.observations {
            seen.descriptor.iter_mut().zip(&other).for_each(|(byte, other)| *byte ^= other);
        }
        town.landmarks.push(landmark);
    }
    for of_block in &block.cross_covariances {
        let mut cross = of_block.clone();
        cross.a += keyframe_id;
        cross.b += keyframe_id;
        town.cross_covariances.push(cross);
    }
}

fn maintain(path: &Path) -> Result<(), Box<dyn Error>> {
    let mut place = place()?;
    place.move_landmarks(0.1, 1);
    let mut session = place.record(1, FIRST_NS + DAY_NS)?;
    let begin = Instant::now();
    let said = |what: &str| println!("{:6.1} s  {what}", begin.elapsed().as_secs_f64());
    let target = MapTarget::new(path, true)?;
    let mut map = load_map(path)?.contents;
    said("read");
    let mut last = None;
    let mut progress = |stage, _, _| {
        if last != Some(stage) {
            println!("{:6.1} s    {stage:?}", begin.elapsed().as_secs_f64());
            last = Some(stage);
        }
    };
    let report =
        take_session(&mut map, &mut session, &BuildOptions::default(), &Settings::default(), &mut progress)?;
    said("worked in");
    target.save(&map)?;
    said("written");
    println!("{report:?}");
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    status.lines().filter(|line| line.starts_with("VmHWM")).for_each(|line| println!("{line}"));
    Ok(())
}
