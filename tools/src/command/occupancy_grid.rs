//! `driftless occupancy-grid`: a map for Nav2's map server.

use crate::map_place::read_map;
use anyhow::Context as _;
use map_io::occupancy::{Cell, Floor, GridSettings, NAV2_YAML, OccupancyGrid};
use serde_json::json;
use std::path::PathBuf;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    driftless occupancy-grid --map hall.db --camera-height 0.4 --out nav2\n  \
    driftless occupancy-grid --map hall.db --floor=-1.2 --heights 0.05,1.5 --resolution 0.1 --out nav2\n\n\
    Writes map.yaml and map.pgm. Landmarks between the heights are obstacles, what cameras looked through is free, all else is unknown.")]
pub struct Args {
    /// Database of the map, or its releases: a folder or URL, with @7 for release 7, or @candidate
    #[arg(long, value_name = "DB|URL")]
    pub map: PathBuf,
    /// Folder of the files, created if needed
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Which landmarks are obstacles
    #[command(flatten)]
    pub grid: GridArguments,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// Which landmarks are obstacles, and in which cells.
#[derive(Clone, Debug, clap::Args)]
pub struct GridArguments {
    /// z of the floor in the map, metres
    #[arg(long, value_name = "Z", allow_hyphen_values = true, conflicts_with = "camera_height")]
    pub floor: Option<f64>,
    /// In place of --floor: how high the cameras of the map were above it (their median), metres
    #[arg(long, value_name = "M")]
    pub camera_height: Option<f64>,
    /// What is between these heights above the floor stops a robot, metres
    #[arg(long, value_name = "LOW,HIGH", value_delimiter = ',', num_args = 1, default_value = "0.1,2")]
    pub heights: Vec<f64>,
    /// Side of a cell, metres
    #[arg(long, value_name = "M", default_value_t = 0.05)]
    pub resolution: f64,
    /// Landmarks that were only seen from farther away are no obstacles, metres
    #[arg(long, value_name = "M", default_value_t = 10.0)]
    pub max_range: f64,
    /// Landmarks that make a cell occupied
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub min_landmarks: u32,
}

impl GridArguments {
    /// The settings.
    ///
    /// # Errors
    /// Other than two heights, or no floor.
    pub fn settings(&self) -> anyhow::Result<GridSettings> {
        let heights_m: [f64; 2] =
            self.heights[..].try_into().context("--heights takes two numbers: LOW,HIGH")?;
        let below = self.camera_height.map(Floor::BelowCameras);
        let floor = self.floor.map(Floor::At).or(below).context("--floor or --camera-height is missing")?;
        Ok(GridSettings {
            resolution_m: self.resolution,
            floor,
            heights_m,
            max_range_m: self.max_range,
            min_landmarks: self.min_landmarks,
        })
    }
}

/// Runs the command.
///
/// # Errors
/// A map that cannot be read or has no such grid, a folder that cannot be written.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let settings = args.grid.settings()?;
    let map = read_map(&args.map)?.contents;
    let grid = OccupancyGrid::of_map(&map, &settings)?;
    grid.write_nav2(&args.out).with_context(|| format!("{} cannot be written", args.out.display()))?;
    let yaml = args.out.join(NAV2_YAML);
    let OccupancyGrid { width, height, resolution_m, origin_m, .. } = grid;
    let [occupied, free, unknown] = [Cell::Occupied, Cell::Free, Cell::Unknown].map(|kind| grid.count(kind));
    if args.json {
        let result = json!({
            "yaml": yaml, "width": width, "height": height, "resolution_m": resolution_m, "origin_m": origin_m,
            "occupied": occupied, "free": free, "unknown": unknown,
        });
        println!("{result:#}");
    } else {
        println!(
            "{}: {width} x {height} cells of {resolution_m} m from ({:.2}, {:.2})",
            yaml.display(),
            origin_m[0],
            origin_m[1]
        );
        println!("  occupied {occupied}, free {free}, unknown {unknown}");
    }
    Ok(())
}
