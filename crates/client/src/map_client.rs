//! Asking a running map server from the shell.

use std::time::{Duration, Instant};

use crate::session::{DEFAULT_ENDPOINT, SessionOptions, close_session, open_session};
use anyhow::{Context, bail};
use nalgebra::Vector3;
use protocol::{
    ErrorReply, Format, LocalizeReply, LocalizeRequest, LocalizedPose, MatchOutcome, Message, keys,
};
use zenoh::Session;
use zenoh::bytes::Encoding;
use zenoh::qos::CongestionControl;
use zenoh::query::ConsolidationMode;

/// Pause before asking again where nobody answered: the session may still be connecting.
const RETRY_AFTER: Duration = Duration::from_millis(200);

/// Where a map server is, and how long to wait for it.
#[derive(Clone, Debug, clap::Args)]
pub struct ServerArguments {
    /// Endpoint of the server or of a router
    #[arg(long, value_name = "ENDPOINT", default_value = DEFAULT_ENDPOINT)]
    pub connect: Vec<String>,
    /// Namespace of the fleet
    #[arg(long, value_name = "PREFIX")]
    pub namespace: Option<String>,
    /// Give up after this time, s
    #[arg(long, value_name = "SECONDS", default_value_t = 5.0)]
    pub timeout: f64,
}

/// An open session to whoever serves a map.
pub struct MapClient<'a> {
    session: Session,
    server: &'a ServerArguments,
    map: &'a str,
    deadline: Instant,
}

impl ServerArguments {
    /// Opens a session, asks, and closes it.
    ///
    /// # Errors
    /// An impossible timeout, no threads, a session that does not open, whatever `ask` says.
    pub fn ask_in_session<'a, T>(
        &'a self,
        map: &'a str,
        ask: impl AsyncFnOnce(&MapClient<'a>) -> anyhow::Result<T>,
    ) -> anyhow::Result<T> {
        if !(self.timeout.is_finite() && self.timeout > 0.0) {
            bail!("--timeout {}: give a positive number of seconds", self.timeout);
        }
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(2)
            .enable_all()
            .build()
            .context("no threads for the network could be started")?;
        let options = SessionOptions {
            connect: self.connect.clone(),
            namespace: self.namespace.clone(),
            ..SessionOptions::default()
        };
        runtime.block_on(async {
            let session = open_session(&options).await?;
            let deadline = Instant::now() + Duration::from_secs_f64(self.timeout);
            let client = MapClient { session, server: self, map, deadline };
            let answer = ask(&client).await;
            close_session(&client.session).await;
            answer
        })
    }
}

impl MapClient<'_> {
    /// Asks where an image was taken.
    ///
    /// # Errors
    /// See [`MapClient::get`].
    pub async fn localize(&self, request: &LocalizeRequest) -> anyhow::Result<LocalizeReply> {
        let poses: Vec<LocalizeReply> = self.get(&keys::map_localize(self.map)?, request, |_| true).await?;
        poses.into_iter().next().context("the server sent no answer")
    }

    /// Asks until there is a complete answer. An empty one says that nobody was there yet, never that nothing matches.
    ///
    /// # Errors
    /// Nobody answers in time, the server refuses, or says what cannot be read.
    pub async fn get<Q: Message, R: Message>(
        &self,
        key: &str,
        request: &Q,
        complete: impl Fn(&[R]) -> bool,
    ) -> anyhow::Result<Vec<R>> {
        let payload = protocol::encode(Format::Bincode, request)?;
        let mut refusal: Option<String> = None;
        loop {
            let left = self.deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                match refusal {
                    Some(message) => bail!("the map server refused: {message}"),
                    None => bail!(
                        "no map server at {} answered within {} s: is map_server running with --map {}=DB, and is \
                         --connect right?",
                        self.server.connect.join(", "),
                        self.server.timeout,
                        self.map
                    ),
                }
            }
            let replies = self
                .session
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
}

fn decode<R: Message>(encoding: &Encoding, bytes: &[u8]) -> anyhow::Result<R> {
    let format = Format::from_encoding(&encoding.to_string()).unwrap_or_default();
    protocol::decode(format, bytes).context("the server's answer cannot be read: is it of this version?")
}

/// Prints a pose with its standard deviations.
pub fn print_fix(fix: &LocalizedPose) {
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

/// An outcome without a pose, in words.
pub fn describe(outcome: MatchOutcome) -> &'static str {
    match outcome {
        MatchOutcome::Matched => "the server matched, but gave no pose",
        MatchOutcome::NoMatch => "no keyframe looks like the image",
        MatchOutcome::NotVerified => "some keyframes look alike, but no pose explains the matches",
        MatchOutcome::TooFewFeatures => "the image has too few features",
        MatchOutcome::Ambiguous => "two places of the map look alike: give a prior pose",
        MatchOutcome::EmptyMap => "the map has no keyframes",
    }
}
