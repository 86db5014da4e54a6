//! `driftless localize`: the pose of a single image.

use std::path::PathBuf;

use onboard::arguments::FeatureArguments;
use protocol::Format;

use crate::query_image::QueryImage;
use crate::server_query::{ServerArguments, describe, print_fix, print_places};

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Example:\n  map_server --map room=vicon_room.db &\n  \
    driftless localize --map room --image query.png --camera V1_01_easy/mav0/cam0/sensor.yaml\n\n\
    Exit code 0: localized. 2: the map was searched and the image was not recognized. 1: anything else.")]
pub struct Args {
    /// Name under which the server serves the map
    #[arg(long, value_name = "NAME")]
    pub map: String,
    /// The image, PNG or JPEG
    #[arg(long, value_name = "FILE")]
    pub image: PathBuf,
    /// The camera that took it: its sensor.yaml, or a camera chain of Kalibr (cam0)
    #[arg(long, value_name = "YAML")]
    pub camera: PathBuf,
    /// How features are extracted
    #[command(flatten)]
    pub features: FeatureArguments,
    /// Where the server is
    #[command(flatten)]
    pub server: ServerArguments,
    /// Print the answer as JSON
    #[arg(long)]
    pub json: bool,
}

/// Exit code for an image that was not recognized.
pub(super) const NOT_RECOGNIZED: i32 = 2;

/// Runs the command.
///
/// # Errors
/// An image, a camera or weights that cannot be read, an image of another size than the camera's, no server, a map that
/// it does not have, features that are not of the map's extractor.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let features = match &args.features.extractor {
        Some(_) => args.features.clone(),
        None => args.features.or_of_map(&args.server.extractor_of(&args.map)?),
    };
    let query = QueryImage::from_file(&args.image, &args.camera, &features)?;
    let request = query.request();
    let reply = args
        .server
        .query_in_session(&args.map, async |client, deadline| client.localize(&request, deadline).await)?;
    if args.json {
        let value: serde_json::Value = serde_json::from_slice(&protocol::encode(Format::Json, &reply)?)?;
        println!("{value:#}");
    } else {
        println!(
            "{}: {} features against map {} (version {})",
            query.name,
            query.features.len(),
            args.map,
            reply.map_version
        );
        match &reply.fix {
            Some(fix) => print_fix(fix),
            None => println!("not localized: {}", describe(reply.outcome)),
        }
        if reply.fix.is_none() {
            print_places(&reply.places);
        }
    }
    if reply.fix.is_none() {
        std::process::exit(NOT_RECOGNIZED);
    }
    Ok(())
}
