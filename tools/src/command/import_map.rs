//! `driftless import-map`: converts a plain-text map to a database.

use std::path::PathBuf;

use anyhow::bail;
use nalgebra::Vector3;
use serde_json::json;

use map::store::MapTarget;
use map_io::text::read_map;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Example:\n  driftless import-map place_as_text --map place.db --sigma-pixel 3\n\n\
                        DIR holds keyframes.csv, landmarks.csv, observations.csv and camera.yaml. The ledger of sessions is sessions.json;\n\
                        without it all keyframes are one session with the name of DIR.")]
pub struct Args {
    /// Folder of the plain-text map
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
    /// Database to create
    #[arg(long, value_name = "DB")]
    pub map: PathBuf,
    /// Direction in which gravity points in the map's frame, for example 0,0,-1 [default: as in DIR, or unknown]
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_direction, allow_hyphen_values = true)]
    pub gravity: Option<Vector3<f64>>,
    /// Standard deviation of the map's pixels in px [default: as in DIR, or 1]
    #[arg(long, value_name = "PX")]
    pub sigma_pixel: Option<f64>,
    /// Replace an existing map: the new one is its next version, with the same identity
    #[arg(long)]
    pub force: bool,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
///
/// # Errors
/// A text file that cannot be read (with its line), a database that exists already or cannot be written.
#[expect(clippy::needless_pass_by_value, reason = "every command owns its arguments")]
pub fn run(args: Args) -> anyhow::Result<()> {
    let target = MapTarget::new(&args.map, args.force)?;
    let mut contents = read_map(&args.folder)?;
    if args.gravity.is_some() {
        contents.info.gravity_in_global = args.gravity;
    }
    if let Some(sigma) = args.sigma_pixel {
        if !(sigma.is_finite() && sigma > 0.0) {
            bail!("--sigma-pixel {sigma}: give a positive number of pixels");
        }
        contents.info.sigma_px = sigma;
    }
    contents.ensure_sessions(&args.folder.file_name().unwrap_or_default().to_string_lossy());
    let saved = target.save(&contents)?;
    let observations = contents.observation_count();
    if args.json {
        let result = json!({
            "map": args.map,
            "version": saved.version,
            "identity": saved.identity,
            "keyframes": contents.keyframes.len(),
            "landmarks": contents.landmarks.len(),
            "observations": observations,
            "cross_covariances": contents.cross_covariances.len(),
        });
        println!("{result:#}");
    } else {
        println!(
            "{}: {} keyframes, {} landmarks, {observations} observations, version {} of map {}",
            args.map.display(),
            contents.keyframes.len(),
            contents.landmarks.len(),
            saved.version,
            saved.identity,
        );
    }
    Ok(())
}

/// A unit vector from three numbers separated by commas.
pub(super) fn parse_direction(text: &str) -> Result<Vector3<f64>, String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|number| number.trim().parse()).collect();
    let direction = match numbers.as_deref() {
        Ok([x, y, z]) => Vector3::new(*x, *y, *z).try_normalize(1e-9),
        _ => None,
    };
    direction
        .filter(|direction| direction.iter().all(|value| value.is_finite()))
        .ok_or_else(|| "a direction of three numbers is needed, for example 0,0,-1".to_owned())
}
