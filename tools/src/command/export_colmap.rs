//! `driftless export-colmap`: converts a database to a COLMAP model.

use std::path::PathBuf;

use map::Keyframe;
use map::store;
use map_io::colmap::{WrittenModel, image_names, write_model};
use serde_json::json;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Example:\n  driftless export-colmap --map room.db --to room_colmap --images .jpg\n\n\
                        COLMAP, hloc and nerfstudio read the model; covariances and descriptors have no place in it.\n\
                        Images are named cam0/STAMP.png, as in a recording: give its mav0 folder's images, or the recording\n\
                        itself to `driftless import-colmap`. COLMAP's bundle_adjuster knows neither the IMU nor the stereo\n\
                        baseline: what it moves loses their scale, and the direction of gravity"
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
    let contents = store::load_map(&args.map)?.contents;
    let names = image_names(&contents.keyframes, &args.images);
    let name = |keyframe: &Keyframe| names.get(&keyframe.id).cloned().unwrap_or_default();
    let WrittenModel { images, points, seen_once } = write_model(&args.to, &contents, name)?;
    if args.json {
        println!(
            "{:#}",
            json!({ "folder": args.to, "images": images, "points": points, "seen_once": seen_once })
        );
    } else {
        println!("{}: {images} images, {points} points", args.to.display());
        if seen_once > 0 {
            println!(
                "left out: {seen_once} landmarks that one image sees, at which COLMAP's adjustment would stop"
            );
        }
        let timeless = contents.keyframes.iter().filter(|keyframe| keyframe.stamp_ns == 0).count();
        if timeless > 0 {
            println!("named by their ids: {timeless} images whose time is not known");
        }
    }
    Ok(())
}
