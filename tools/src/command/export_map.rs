//! `driftless export-map`: converts a database to a plain-text map.

use std::path::PathBuf;

use map::{MapContents, store};
use serde_json::json;

use map_io::text::write_map;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Example:\n  driftless export-map --map yq.db --to yq_text\n\n\
                        `driftless import-map yq_text --map copy.db` restores an equal map.")]
pub struct Args {
    /// Database of the map
    #[arg(long, value_name = "DB")]
    pub map: PathBuf,
    /// Folder to write, created if needed
    #[arg(long, value_name = "DIR")]
    pub to: PathBuf,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
///
/// # Errors
/// A database that is missing, damaged or in use, a folder that holds a map already or cannot be written.
#[expect(clippy::needless_pass_by_value, reason = "every command owns its arguments")]
pub fn run(args: Args) -> anyhow::Result<()> {
    let contents = store::load_map(&args.map)?.contents;
    write_map(&args.to, &contents)?;
    let observations = contents.observation_count();
    if args.json {
        let result = json!({
            "folder": args.to,
            "version": contents.info.version,
            "keyframes": contents.keyframes.len(),
            "landmarks": contents.landmarks.len(),
            "observations": observations,
            "cross_covariances": contents.cross_covariances.len(),
        });
        println!("{result:#}");
    } else {
        println!(
            "{}: {} keyframes, {} landmarks, {observations} observations",
            args.to.display(),
            contents.keyframes.len(),
            contents.landmarks.len(),
        );
        for part in left_out(&contents) {
            println!("left out of the text: {part}");
        }
    }
    Ok(())
}

/// What a map has that the text form does not carry.
fn left_out(contents: &MapContents) -> Vec<String> {
    let features =
        contents.added_features.iter().map(|added| format!("features of {}", added.kind.extractor));
    let images = (!contents.images.is_empty()).then(|| format!("{} images", contents.images.len()));
    features.chain(images).collect()
}
