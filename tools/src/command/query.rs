//! `driftless query`: queries a running map server.

use std::path::{Path, PathBuf};
use std::time::Instant;

use protocol::{
    DescriptorKind, FeatureSet, Format, LocalizeReply, LocalizeRequest, MatchReply, MatchRequest,
    MatchStatus, MatchedKeyframe, Message,
};
use serde_json::{Value, json};

use crate::server_query::{ServerArguments, describe, print_fix};
use client::{ClientError, MapClient};
use map_io::text::{read_camera, read_image_features};

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Example:\n  map_server --map town=town.db &\n  \
    driftless query --map town --features town/live/mav0/cam0/features.csv\n\n\
    FILE has lines of: timestamp [ns],u [px],v [px],descriptor [hex]. The camera is read from sensor.yaml beside it.")]
pub struct Args {
    /// Name under which the server serves the map
    #[arg(long, value_name = "NAME")]
    pub map: String,
    /// Features of an image
    #[arg(long, value_name = "FILE")]
    pub features: PathBuf,
    /// Which image of FILE, ns [default: the first]
    #[arg(long, value_name = "NS")]
    pub stamp: Option<i64>,
    /// Camera of the image: its sensor.yaml, or a camera chain of Kalibr (cam0) [default: sensor.yaml beside FILE]
    #[arg(long, value_name = "YAML")]
    pub camera: Option<PathBuf>,
    /// The descriptors are f32 numbers, not bits
    #[arg(long)]
    pub float: bool,
    /// Most keyframes in the reply
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u16).range(1..=64))]
    pub max_keyframes: u16,
    /// Request only the pose
    #[arg(long)]
    pub localize: bool,
    /// Where the server is
    #[command(flatten)]
    pub server: ServerArguments,
    /// Print the answer as JSON
    #[arg(long)]
    pub json: bool,
}

/// Replies of the server.
struct Answer {
    keyframes: Vec<MatchedKeyframe>,
    status: Option<MatchStatus>,
    pose: LocalizeReply,
}

/// Runs the command.
///
/// # Errors
/// A file that cannot be read (with its line), no server, a map that it does not have, an error that it replies.
#[expect(clippy::needless_pass_by_value, reason = "every command owns its arguments")]
pub fn run(args: Args) -> anyhow::Result<()> {
    let kind = if args.float { DescriptorKind::Float } else { DescriptorKind::Binary };
    let (stamp_ns, features) = read_image_features(&args.features, args.stamp, kind)?;
    let beside = || args.features.parent().unwrap_or(Path::new(".")).join("sensor.yaml");
    let camera = read_camera(&args.camera.clone().unwrap_or_else(beside))?;
    let answer = args.server.query_in_session(&args.map, async |client, deadline| {
        ask(client, deadline, &args, stamp_ns, &features, camera).await
    })?;
    if args.json {
        println!("{:#}", as_json(stamp_ns, &answer)?);
    } else {
        print_answer(&args.map, stamp_ns, features.pixels.len(), &answer);
    }
    Ok(())
}

async fn ask(
    client: &MapClient,
    deadline: Instant,
    args: &Args,
    stamp_ns: i64,
    features: &FeatureSet,
    camera: geometry::camera::Camera,
) -> Result<Answer, ClientError> {
    let request = LocalizeRequest {
        camera: camera.clone(),
        features: features.clone(),
        prior: None,
        gravity_in_camera: None,
    };
    let pose = client.localize(&request, deadline).await?;
    let mut answer = Answer { keyframes: Vec::new(), status: None, pose };
    if args.localize {
        return Ok(answer);
    }
    let request = MatchRequest {
        robot: "driftless-query".to_owned(),
        stamp_ns,
        camera,
        features: features.clone(),
        prior: None,
        gravity_in_camera: None,
        held: Vec::new(),
        map_version_held: None,
        max_keyframes: args.max_keyframes,
    };
    let matched = client.match_image(&request, deadline).await?;
    answer.keyframes = matched.keyframes;
    answer.status = Some(matched.status);
    answer.keyframes.sort_by_key(|keyframe| keyframe.rank);
    Ok(answer)
}

/// A message as a JSON value.
fn value<M: Message>(message: &M) -> anyhow::Result<Value> {
    Ok(serde_json::from_slice(&protocol::encode(Format::Json, message)?)?)
}

fn as_json(stamp_ns: i64, answer: &Answer) -> anyhow::Result<Value> {
    let mut result = json!({ "stamp_ns": stamp_ns, "localize": value(&answer.pose)? });
    if let Some(status) = &answer.status {
        let keyframes: anyhow::Result<Vec<Value>> =
            answer.keyframes.iter().map(|keyframe| value(&MatchReply::Keyframe(keyframe.clone()))).collect();
        result["keyframes"] = Value::Array(keyframes?);
        result["status"] = value(&MatchReply::Done(status.clone()))?;
    }
    Ok(result)
}

fn print_answer(map: &str, stamp_ns: i64, features: usize, answer: &Answer) {
    println!("image {stamp_ns}: {features} features against map {map} (version {})", answer.pose.map_version);
    if let Some(status) = &answer.status {
        println!(
            "{} of {} keyframes, {:.1} ms",
            answer.keyframes.len(),
            status.searched_keyframes,
            status.elapsed_us as f64 * 1e-3
        );
        for keyframe in &answer.keyframes {
            let p = &keyframe.keyframe.global_from_keyframe.pose.translation;
            println!(
                "  keyframe {:>6} at ({:.2}, {:.2}, {:.2}) m: {} matches",
                keyframe.keyframe.id,
                p.x,
                p.y,
                p.z,
                keyframe.matches.len()
            );
        }
    }
    let Some(fix) = &answer.pose.fix else {
        println!("not localized: {}", describe(answer.pose.outcome));
        return;
    };
    print_fix(fix);
}
