//! Asks a running map server where an image was taken.
//!
//! ```text
//! cargo run -p driftless-client --example localize -- MAP [ENDPOINT] [REQUEST.json]
//! ```
//! `REQUEST.json` is a `localize_request` as in `protocol/examples/json/localize_request.json`. Without it, random
//! features are sent, which match no place of the map.

use client::{DEFAULT_ENDPOINT, MapClient, SessionOptions, close_session, open_session};
use geometry::{Camera, Distortion};
use protocol::{
    DescriptorFormat, DescriptorKind, Descriptors, FeatureSet, Format, LocalizeRequest, MapInfoReply,
};
use rand::RngExt as _;
use std::time::{Duration, Instant};

type Error = Box<dyn std::error::Error + Send + Sync>;

const USAGE: &str = "usage: localize MAP [ENDPOINT] [REQUEST.json]";
/// Time for all queries together.
const TIMEOUT: Duration = Duration::from_secs(5);

#[tokio::main]
async fn main() -> Result<(), Error> {
    let mut arguments = std::env::args().skip(1);
    let map = arguments.next().ok_or(USAGE)?;
    let connect = vec![arguments.next().unwrap_or_else(|| DEFAULT_ENDPOINT.to_owned())];
    let file = arguments.next();

    let options = SessionOptions { connect, ..SessionOptions::default() };
    // A client waits until somebody answers.
    let session = tokio::time::timeout(TIMEOUT, open_session(&options)).await??;
    let client = MapClient::new(session.clone(), &map)?;
    let result = ask(&client, file.as_deref()).await;
    close_session(&session).await;
    result
}

async fn ask(client: &MapClient, file: Option<&str>) -> Result<(), Error> {
    let deadline = Instant::now() + TIMEOUT;
    let info = client.info(deadline).await?;
    println!(
        "map {} version {}: {} keyframes, {} landmarks",
        info.name, info.version, info.keyframes, info.landmarks
    );

    let request = match file {
        Some(path) => protocol::decode(Format::Json, &std::fs::read(path)?)?,
        None => random_request(&info),
    };
    let reply = client.localize(&request, deadline).await?;
    match reply.fix {
        Some(fix) => {
            let p = fix.global_from_camera.pose.translation;
            println!("camera at ({:.3}, {:.3}, {:.3}) m, {} inliers", p.x, p.y, p.z, fix.inliers);
        }
        None => println!("not localized: {:?}", reply.outcome),
    }
    Ok(())
}

/// Random features in the descriptor format of the map.
fn random_request(info: &MapInfoReply) -> LocalizeRequest {
    let format = info.descriptors.unwrap_or(DescriptorFormat { kind: DescriptorKind::Binary, width: 32 });
    let mut rng = rand::rng();
    let pixels: Vec<[f32; 2]> =
        (0..300).map(|_| [rng.random_range(0.0..640.0), rng.random_range(0.0..480.0)]).collect();
    // Small numbers in every kind of descriptor: bits, signed bytes, or the bytes of finite floats.
    let bytes = (0..pixels.len() * usize::from(format.width)).map(|_| rng.random_range(0..0x3f)).collect();
    let descriptors = Descriptors { kind: format.kind, width: format.width, bytes };
    LocalizeRequest {
        camera: Camera {
            width: 640,
            height: 480,
            focal: [500.0; 2],
            centre: [319.5, 239.5],
            distortion: Distortion::None,
        },
        features: FeatureSet { pixels, descriptors, extractor: info.extractor.clone() },
        prior: None,
        gravity_in_camera: None,
    }
}
