//! Simulates a short recording, builds a map from it, prints the report and writes the map to a temporary database.
//!
//! `cargo run --release -p driftless-mapping --example build_map`

use mapping::{BuildOptions, build_map};
use nalgebra::Vector3;
use simulation::{SimulationOptions, simulate};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let simulation = SimulationOptions { duration_s: Some(12.0), ..SimulationOptions::default() };
    let recording = simulate(&simulation)?.map;
    let references = recording.reference_poses.clone().ok_or("the simulation gives reference poses")?;

    let mut options = BuildOptions::default();
    options.name = String::from("street");
    options.created_by = String::from("example build_map");
    options.gravity_in_global = Some(-Vector3::z());
    let mut stage = None;
    let (contents, report) = build_map(&recording, &references, None, &options, &mut |now, _, _| {
        if stage.replace(now) != Some(now) {
            println!("{} ...", now.label());
        }
    })?;

    println!(
        "{} keyframes, {} landmarks, {} observations",
        report.keyframes, report.landmarks, report.observations
    );
    println!("reprojection error (px), reference poses {:.2?}", report.reprojection_through_given_px);
    println!("reprojection error (px), refined poses   {:.2?}", report.reprojection_px);
    println!("sigma of the poses (m) {:.3?}, (deg) {:.3?}", report.sigma_pose_m, report.sigma_pose_deg);
    println!("{} cross-covariances of keyframes", report.cross_covariances);

    let folder = tempfile::tempdir()?;
    let path = folder.path().join("street.db");
    let version = map::store::save_map(&path, &contents, false)?.version;
    let stored = map::store::load_map(&path)?.contents;
    println!("{}: version {version}, {} keyframes", path.display(), stored.keyframes.len());
    Ok(())
}
