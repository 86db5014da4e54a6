//! Asking a running map server from the shell: where it is, the queries, and how answers are printed.

use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};
use client::{ClientError, MapClient, SessionArguments, close_session, open_session};
use nalgebra::Vector3;
use protocol::{LocalizedPose, MatchOutcome, PossiblePlace};

/// Where a map server is, and how long to wait for it.
#[derive(Clone, Debug, clap::Args)]
pub struct ServerArguments {
    /// How to connect [default: --connect tcp/127.0.0.1:7447]
    #[command(flatten)]
    pub session: SessionArguments,
    /// Give up after this time, s
    #[arg(long, value_name = "SECONDS", default_value_t = 5.0)]
    pub timeout: f64,
}

impl ServerArguments {
    /// Opens a session, sends queries to a map until the deadline, and closes the session.
    ///
    /// # Errors
    /// An invalid timeout or name, no threads, a session that does not open, no answer before the deadline, a refusal.
    pub fn query_in_session<T>(
        &self,
        map: &str,
        query: impl AsyncFnOnce(&MapClient, Instant) -> Result<T, ClientError>,
    ) -> anyhow::Result<T> {
        if !(self.timeout.is_finite() && self.timeout > 0.0) {
            bail!("--timeout {}: give a positive number of seconds", self.timeout);
        }
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(2)
            .enable_all()
            .build()
            .context("no threads for the network could be started")?;
        let options = self.session.connecting();
        runtime.block_on(async {
            let deadline = Instant::now() + Duration::from_secs_f64(self.timeout);
            let Ok(session) = tokio::time::timeout_at(deadline.into(), open_session(&options)).await else {
                return Err(self.explain(ClientError::NoServer, map));
            };
            let session = session?;
            let client = MapClient::new(session.clone(), map).context("--map")?.awaiting_map();
            let answer = query(&client, deadline).await;
            close_session(&session).await;
            answer.map_err(|error| self.explain(error, map))
        })
    }

    /// The extractor that a map was built with; empty where it is not known.
    ///
    /// # Errors
    /// As [`ServerArguments::query_in_session`].
    pub fn extractor_of(&self, map: &str) -> anyhow::Result<String> {
        Ok(self.query_in_session(map, async |client, deadline| client.info(deadline).await)?.extractor)
    }

    fn explain(&self, error: ClientError, map: &str) -> anyhow::Error {
        match error {
            ClientError::Refused(reply) => anyhow::anyhow!("the map server refused: {}", reply.message),
            ClientError::Unreadable(error) => anyhow::Error::new(error)
                .context("the server's answer cannot be read: is it of this version?"),
            error if error.is_transient() => anyhow::anyhow!(
                "no map server at {} answered within {} s ({error}): is map_server running with --map {map}=DB, and is \
                 --connect right?",
                self.session.place(),
                self.timeout
            ),
            error => error.into(),
        }
    }
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

/// Prints the places that an image could be of, with their odds.
pub fn print_places(places: &[PossiblePlace]) {
    for place in places {
        let at = &place.global_from_camera.pose.translation;
        println!(
            "  could be at ({:.3}, {:.3}, {:.3}) m: {} features, odds {:.2} against a place that looks alike",
            at.x,
            at.y,
            at.z,
            place.features,
            place.log_odds.exp()
        );
    }
}

/// Describes an outcome without a pose.
pub fn describe(outcome: MatchOutcome) -> &'static str {
    match outcome {
        MatchOutcome::Matched => "the server matched, but gave no pose",
        MatchOutcome::NoMatch => "no keyframe looks like the image",
        MatchOutcome::NotVerified => {
            "some keyframes look alike, but no pose explains the matches: is --camera the one that took the image?"
        }
        MatchOutcome::TooFewFeatures => "the image has too few features",
        MatchOutcome::Ambiguous => {
            "the image is not distinctive: other places look alike, at least in part; take one that shows more of its surroundings"
        }
        MatchOutcome::EmptyMap => "the map has no keyframes",
    }
}
