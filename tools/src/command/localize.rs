//! `driftless localize`: the pose of a single image, by a server or by a map that is read here.

use std::path::{Path, PathBuf};

use client::SessionArguments;
use map::store;
use onboard::arguments::FeatureArguments;
use protocol::{Format, LocalizeReply};
use recognition::RecognitionOptions;

use crate::in_process::load_map;
use crate::query_image::QueryImage;
use crate::server_query::{ServerArguments, describe, print_fix, print_places};

/// How long a server is waited for, seconds.
const TIMEOUT_S: f64 = 5.0;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  map_server --map room=vicon_room.db &\n  \
    driftless localize --map room --image query.png --camera V1_01_easy/mav0/cam0/sensor.yaml\n  \
    driftless localize --map s3://bucket/city@candidate --image query.png --camera sensor.yaml\n\n\
    Exit code 0: localized. 2: the map was searched and the image was not recognized. 1: anything else.")]
pub struct Args {
    /// Name under which a server serves the map; or the map itself, read by this command: a path like ./room.db, or the folder or URL
    /// of its releases, with @7 for release 7, or @candidate
    #[arg(long, value_name = "NAME|DB|URL")]
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
    /// How to connect [default: --connect tcp/127.0.0.1:7447]
    #[command(flatten)]
    pub session: SessionArguments,
    /// Give up after this time, s [default: 5]
    #[arg(long, value_name = "SECONDS")]
    pub timeout: Option<f64>,
    /// Print the answer as JSON
    #[arg(long)]
    pub json: bool,
}

/// Whether a map is to be read here: a path or a place of releases, and no name under which a server serves it.
fn is_path(map: &str) -> bool {
    let path = Path::new(map);
    map.contains(['/', '\\', '@']) || path.extension().is_some_and(|end| end == "db") && store::is_map(path)
}

fn ask_map(args: &Args) -> anyhow::Result<(QueryImage, LocalizeReply)> {
    anyhow::ensure!(
        !args.session.is_given() && args.timeout.is_none(),
        "--map {} is a map that is read here, and --timeout and the switches of a session are about a server: leave them out, or give the \
         name under which the server serves it",
        args.map
    );
    let map = load_map(Path::new(&args.map))?;
    let features = args.features.or_of_map(&map.info().extractor);
    let query = QueryImage::from_file(&args.image, &args.camera, &features)?;
    let reply = map.localize(&query.request(), &RecognitionOptions::default())?;
    Ok((query, reply))
}

fn ask_server(args: &Args) -> anyhow::Result<(QueryImage, LocalizeReply)> {
    let server =
        ServerArguments { session: args.session.clone(), timeout: args.timeout.unwrap_or(TIMEOUT_S) };
    let features = match &args.features.extractor {
        Some(_) => args.features.clone(),
        None => args.features.or_of_map(&server.extractor_of(&args.map)?),
    };
    let query = QueryImage::from_file(&args.image, &args.camera, &features)?;
    let request = query.request();
    let reply = server
        .query_in_session(&args.map, async |client, deadline| client.localize(&request, deadline).await)?;
    Ok((query, reply))
}

/// Exit code for an image that was not recognized.
pub(super) const NOT_RECOGNIZED: i32 = 2;

/// Runs the command.
///
/// # Errors
/// An image, a camera or weights that cannot be read, an image of another size than the camera's, no server, a map that
/// it does not have, features that are not of the map's extractor.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let (query, reply) = if is_path(&args.map) { ask_map(args)? } else { ask_server(args)? };
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

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser as _;

    #[derive(clap::Parser)]
    struct Line {
        #[command(flatten)]
        args: Args,
    }

    #[test]
    fn a_map_that_is_read_here_refuses_the_switches_of_a_server() {
        let line = "localize --map ./room.db --image query.png --camera sensor.yaml";
        for switch in ["--timeout 5", "--connect tcp/10.0.0.1:7447"] {
            let Line { args } = Line::try_parse_from(line.split(' ').chain(switch.split(' '))).unwrap();
            assert!(is_path(&args.map));
            let refusal = ask_map(&args).map(drop).unwrap_err().to_string();
            assert!(refusal.contains("leave them out"), "{switch}: {refusal}");
        }
    }
}
