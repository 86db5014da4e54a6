//! `driftless extract-features`: the features of an image, as a query that any client can send.

use crate::query_image::QueryImage;
use onboard::arguments::FeatureArguments;
use protocol::Format;
use std::io::Write as _;
use std::path::PathBuf;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Example:\n  driftless extract-features --image query.png --camera sensor.yaml > request.json\n\n\
    Prints a request for map/{map}/localize, which takes JSON from any client of Zenoh; `prior` and\n\
    `gravity_in_camera` may be added to it. `driftless localize` extracts and asks in one step."
)]
pub struct Args {
    /// The image, PNG or JPEG
    #[arg(long, value_name = "FILE")]
    image: PathBuf,
    /// The camera that took it: its sensor.yaml, or a camera chain of Kalibr (cam0)
    #[arg(long, value_name = "YAML")]
    camera: PathBuf,
    /// How features are extracted
    #[command(flatten)]
    features: FeatureArguments,
}

/// Runs the command.
///
/// # Errors
/// An image, a camera or weights that cannot be read, an image of another size than the camera's.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let request = QueryImage::from_file(&args.image, &args.camera, &args.features)?.request();
    let mut payload = protocol::encode(Format::Json, &request)?;
    payload.push(b'\n');
    Ok(std::io::stdout().write_all(&payload)?)
}
