//! `driftless export-colmap`: converts a database to a COLMAP model.

use std::path::PathBuf;

use map::colmap::write_model;
use map::store;
use serde_json::json;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Example:\n  driftless export-colmap --map room.db --to room_colmap --images .jpg\n\n\
                        COLMAP, hloc and nerfstudio read the model; covariances and descriptors have no place in it."
)]
pub struct Args {
    /// Database of the map
    #[arg(long, value_name = "DB")]
    pub map: PathBuf,
    /// Folder to write, created if needed
    #[arg(long, value_name = "DIR")]
    pub to: PathBuf,
    /// What follows the time stamp in the names of the images
    #[arg(long, value_name = "SUFFIX", default_value = ".png")]
    pub images: String,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
///
/// # Errors
/// A database that is missing, damaged or in use, a folder that holds a model already or cannot be written.
#[expect(clippy::needless_pass_by_value, reason = "every command owns its arguments")]
pub fn run(args: Args) -> anyhow::Result<()> {
    let contents = store::load_map(&args.map)?.whole()?;
    write_model(&args.to, &contents, |keyframe| format!("{}{}", keyframe.stamp_ns, args.images))?;
    let (images, points) = (contents.keyframes.len(), contents.landmarks.len());
    if args.json {
        println!("{:#}", json!({ "folder": args.to, "images": images, "points": points }));
    } else {
        println!("{}: {images} images, {points} points", args.to.display());
    }
    Ok(())
}
