//! `driftless import-map`: a plain-text map becomes a database.

use std::path::PathBuf;

use anyhow::{Context, bail};
use map_server::contents::MapContents;
use nalgebra::Vector3;
use serde_json::json;

use crate::map_files::{read_map, save_map};

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Example:\n  driftless import-map target/data/yq_real/map --map yq.db --pixel-sigma 3\n\n\
                        DIR holds keyframes.csv, landmarks.csv, observations.csv and camera.yaml.")]
pub struct Args {
    /// Folder of the plain-text map
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
    /// Database to make
    #[arg(long, value_name = "DB")]
    pub map: PathBuf,
    /// Direction in which gravity points in the map's frame, for example 0,0,-1 [default: as in DIR, or unknown]
    #[arg(long, value_name = "X,Y,Z", value_delimiter = ',', num_args = 3, allow_hyphen_values = true)]
    pub gravity: Option<Vec<f64>>,
    /// Standard deviation of the map's pixels in px [default: as in DIR, or 1]
    #[arg(long, value_name = "PX")]
    pub pixel_sigma: Option<f64>,
    /// Replace a map that is there already
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
pub fn run(args: Args) -> anyhow::Result<()> {
    let mut contents = read_map(&args.folder)?;
    apply_options(&mut contents, args.gravity.as_deref(), args.pixel_sigma)?;
    let version = save_map(&args.map, &contents, args.force)
        .with_context(|| hint(&args.map, args.force))?;
    let observations = contents.observation_count();
    if args.json {
        let result = json!({
            "map": args.map,
            "version": version,
            "keyframes": contents.keyframes.len(),
            "landmarks": contents.landmarks.len(),
            "observations": observations,
            "cross_covariances": contents.cross_covariances.len(),
        });
        println!("{result:#}");
    } else {
        println!(
            "{}: {} keyframes, {} landmarks, {observations} observations, version {version}",
            args.map.display(),
            contents.keyframes.len(),
            contents.landmarks.len(),
        );
    }
    Ok(())
}

/// What to say before the store's own words.
pub(super) fn hint(map: &std::path::Path, force: bool) -> String {
    let remedy = if force { "" } else { " (an existing map is replaced only with --force)" };
    format!("the map cannot be written to {}{remedy}", map.display())
}

/// Puts what the command line says about a map into its info.
pub(super) fn apply_options(
    contents: &mut MapContents,
    gravity: Option<&[f64]>,
    pixel_sigma: Option<f64>,
) -> anyhow::Result<()> {
    if let Some(gravity) = gravity {
        contents.info.gravity_in_global = Some(gravity_direction(gravity)?);
    }
    if let Some(sigma) = pixel_sigma {
        if !(sigma.is_finite() && sigma > 0.0) {
            bail!("--pixel-sigma {sigma}: give a positive number of pixels");
        }
        contents.info.pixel_sigma = sigma;
    }
    Ok(())
}

/// The unit vector that `--gravity` means.
pub(super) fn gravity_direction(gravity: &[f64]) -> anyhow::Result<Vector3<f64>> {
    match *gravity {
        [x, y, z] => Vector3::new(x, y, z)
            .try_normalize(1e-9)
            .filter(|direction| direction.iter().all(|value| value.is_finite()))
            .context("--gravity has no direction: give for example 0,0,-1"),
        _ => bail!("--gravity takes three numbers, for example 0,0,-1"),
    }
}
