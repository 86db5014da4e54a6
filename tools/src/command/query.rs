//! `driftless query`: asks a running map server from the shell.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use nalgebra::Vector3;
use protocol::session::{DEFAULT_ENDPOINT, SessionOptions, close_session, open_session};
use protocol::{
    DescriptorKind, ErrorReply, FeatureSet, Format, LocalizeReply, LocalizeRequest, MatchReply, MatchRequest,
    MatchStatus, MatchedKeyframe, Message, keys,
};
use serde_json::{Value, json};
use zenoh::Session;
use zenoh::bytes::Encoding;
use zenoh::qos::CongestionControl;
use zenoh::query::ConsolidationMode;

use crate::map_files::{read_camera, read_image_features};

/// Pause before asking again where nobody answered: the session may still be connecting.
const RETRY_AFTER: Duration = Duration::from_millis(200);

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Example:\n  map_server --map place=place.db &\n  \
    driftless query --map place --features place/live/mav0/cam0/features.csv\n\n\
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
    /// Camera of the image [default: sensor.yaml beside FILE]
    #[arg(long, value_name = "YAML")]
    pub camera: Option<PathBuf>,
    /// The descriptors are f32 numbers, not bits
    #[arg(long)]
    pub float: bool,
    /// Most keyframes to ask for
    #[arg(long, value_name = "N", default_value_t = 4)]
    pub max_keyframes: u16,
    /// Ask for the pose only
    #[arg(long)]
    pub localize: bool,
    /// Endpoint of the server or of a router
    #[arg(long, value_name = "ENDPOINT", default_value = DEFAULT_ENDPOINT)]
    pub connect: Vec<String>,
    /// Namespace of the fleet
    #[arg(long, value_name = "PREFIX")]
    pub namespace: Option<String>,
    /// Give up after this time, s
    #[arg(long, value_name = "SECONDS", default_value_t = 5.0)]
    pub timeout: f64,
    /// Print the answer as JSON
    #[arg(long)]
    pub json: bool,
}

/// What the server said.
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
    if !(args.timeout.is_finite() && args.timeout > 0.0) {
        bail!("--timeout {}: give a positive number of seconds", args.timeout);
    }
    let kind = if args.float { DescriptorKind::Float } else { DescriptorKind::Binary };
    let (stamp_ns, features) = read_image_features(&args.features, args.stamp, kind)?;
    let beside = || args.features.parent().unwrap_or(Path::new(".")).join("sensor.yaml");
    let camera = read_camera(&args.camera.clone().unwrap_or_else(beside))?;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .context("no threads for the network could be started")?;
    let answer = runtime.block_on(ask(&args, stamp_ns, &features, camera))?;
    if args.json {
        println!("{:#}", as_json(stamp_ns, &answer)?);
    } else {
        print_answer(&args.map, stamp_ns, features.pixels.len(), &answer);
    }
    Ok(())
}

async fn ask(
    args: &Args,
    stamp_ns: i64,
    features: &FeatureSet,
    camera: geometry::camera::Camera,
) -> anyhow::Result<Answer> {
    let options = SessionOptions {
        connect: args.connect.clone(),
        namespace: args.namespace.clone(),
        ..SessionOptions::default()
    };
    let session = open_session(&options).await?;
    let deadline = Instant::now() + Duration::from_secs_f64(args.timeout);
    let answer = ask_in_session(&session, args, stamp_ns, features, camera, deadline).await;
    close_session(&session).await;
    answer
}

async fn ask_in_session(
    session: &Session,
    args: &Args,
    stamp_ns: i64,
    features: &FeatureSet,
    camera: geometry::camera::Camera,
    deadline: Instant,
) -> anyhow::Result<Answer> {
    let request = LocalizeRequest {
        camera: camera.clone(),
        features: features.clone(),
        prior: None,
        gravity_in_camera: None,
    };
    let key = keys::map_localize(&args.map)?;
    let poses: Vec<LocalizeReply> = get(session, &key, &request, args, deadline, |_| true).await?;
    let pose = poses.into_iter().next().context("the server sent no answer")?;
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
    let finished = |replies: &[MatchReply]| replies.iter().any(|reply| matches!(reply, MatchReply::Done(_)));
    for reply in get(session, &keys::map_match(&args.map)?, &request, args, deadline, finished).await? {
        match reply {
            MatchReply::Keyframe(keyframe) => answer.keyframes.push(keyframe),
            MatchReply::Done(status) => answer.status = Some(status),
        }
    }
    answer.keyframes.sort_by_key(|keyframe| keyframe.rank);
    Ok(answer)
}

/// Asks until there is a complete answer. An empty one says that nobody was there yet, never that nothing matches.
async fn get<Q: Message, R: Message>(
    session: &Session,
    key: &str,
    request: &Q,
    args: &Args,
    deadline: Instant,
    complete: impl Fn(&[R]) -> bool,
) -> anyhow::Result<Vec<R>> {
    let payload = protocol::encode(Format::Bincode, request)?;
    let mut refusal: Option<String> = None;
    loop {
        let left = deadline.saturating_duration_since(Instant::now());
        if left.is_zero() {
            match refusal {
                Some(message) => bail!("the map server refused: {message}"),
                None => bail!(
                    "no map server at {} answered within {} s: is map_server running with --map {}=DB, and is \
                     --connect right?",
                    args.connect.join(", "),
                    args.timeout,
                    args.map
                ),
            }
        }
        let replies = session
            .get(key)
            .payload(payload.clone())
            .encoding(Encoding::from(Format::Bincode.encoding()))
            .consolidation(ConsolidationMode::None)
            .congestion_control(CongestionControl::Block)
            .timeout(left)
            .await
            .map_err(|error| anyhow::anyhow!("the query could not be sent: {error}"))?;
        let mut received: Vec<R> = Vec::new();
        while let Ok(reply) = replies.recv_async().await {
            match reply.result() {
                Ok(sample) => received.push(decode(sample.encoding(), &sample.payload().to_bytes())?),
                Err(error) => {
                    let said: anyhow::Result<ErrorReply> =
                        decode(error.encoding(), &error.payload().to_bytes());
                    refusal = said.ok().map(|said| said.message);
                }
            }
        }
        if !received.is_empty() && complete(&received) {
            return Ok(received);
        }
        tokio::time::sleep(RETRY_AFTER.min(left)).await;
    }
}

fn decode<R: Message>(encoding: &Encoding, bytes: &[u8]) -> anyhow::Result<R> {
    let format = Format::from_encoding(&encoding.to_string()).unwrap_or_default();
    protocol::decode(format, bytes).context("the server's answer cannot be read: is it of this version?")
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
        println!("not localized: {}", value_name(&answer.pose));
        return;
    };
    let pose = &fix.global_from_camera.pose;
    let (p, q) = (&pose.translation, pose.rotation.quaternion());
    let covariance = fix.global_from_camera.covariance.diagonal();
    let sigma = |first: usize| Vector3::from_fn(|axis, _| covariance[first + axis].sqrt());
    let (theta, position) = (sigma(0) * 1.0_f64.to_degrees(), sigma(3));
    println!(
        "camera at ({:.3}, {:.3}, {:.3}) m, q = ({:.5}, {:.5}, {:.5}, {:.5})",
        p.x, p.y, p.z, q.w, q.i, q.j, q.k
    );
    println!(
        "  sigma ({:.3}, {:.3}, {:.3}) m, ({:.2}, {:.2}, {:.2}) deg",
        position.x, position.y, position.z, theta.x, theta.y, theta.z
    );
    println!(
        "  {} of {} matches agree within {:.2} px on average, best keyframe {}",
        fix.inliers, fix.matched_features, fix.mean_error_px, fix.keyframe
    );
}

/// The outcome in words.
fn value_name(reply: &LocalizeReply) -> &'static str {
    match reply.outcome {
        protocol::MatchOutcome::Matched => "the server matched, but gave no pose",
        protocol::MatchOutcome::NoMatch => "no keyframe looks like the image",
        protocol::MatchOutcome::NotVerified => "some keyframes look alike, but no pose explains the matches",
        protocol::MatchOutcome::TooFewFeatures => "the image has too few features",
        protocol::MatchOutcome::Ambiguous => "two places of the map look alike: give a prior pose",
        protocol::MatchOutcome::EmptyMap => "the map has no keyframes",
    }
}
