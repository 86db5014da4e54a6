//! `driftless localize`: one image, one pose.

use std::path::PathBuf;

use onboard::robot::extraction::{FeatureArguments, feature_set};
use protocol::{Format, LocalizeRequest};
use vision::GrayImage;

use crate::client::{ServerArguments, in_words, print_fix};
use crate::map_files::read_camera;

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
    /// The camera that took it: a sensor.yaml in the form of EuRoC or Kalibr
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

/// Exit code for an image that the map does not know.
const NOT_RECOGNIZED: i32 = 2;

/// Runs the command.
///
/// # Errors
/// An image, a camera or weights that cannot be read, an image of another size than the camera's, no server, a map that
/// it does not have, features that are not of the map's extractor.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let camera = read_camera(&args.camera)?;
    let image = GrayImage::read(&args.image)?;
    if (image.width(), image.height()) != (camera.width as usize, camera.height as usize) {
        anyhow::bail!(
            "{} has {} x {} pixels, the camera of {} {} x {}: give the camera that took the image",
            args.image.display(),
            image.width(),
            image.height(),
            args.camera.display(),
            camera.width,
            camera.height
        );
    }
    let mut extractor = args.features.open()?;
    let mask = args.features.read_mask()?;
    let seen = extractor.extract(&image, mask.as_ref(), args.features.max_features)?;
    let features = feature_set(extractor.name(), seen);
    let count = features.len();
    let request = LocalizeRequest { camera, features, prior: None, gravity_in_camera: None };
    let reply = args.server.ask_in_session(&args.map, async |client| client.localize(&request).await)?;
    if args.json {
        let value: serde_json::Value = serde_json::from_slice(&protocol::encode(Format::Json, &reply)?)?;
        println!("{value:#}");
    } else {
        println!(
            "{}: {count} features against map {} (version {})",
            args.image.display(),
            args.map,
            reply.map_version
        );
        match &reply.fix {
            Some(fix) => print_fix(fix),
            None => println!("not localized: {}", in_words(reply.outcome)),
        }
    }
    if reply.fix.is_none() {
        std::process::exit(NOT_RECOGNIZED);
    }
    Ok(())
}
