//! A map server and robots in one process, over Zenoh on the loopback interface.

use crate::map_place::{is_released, read_map};
use crate::plotting::RunFiles;
use crate::run_tracks::run_tracks;
use anyhow::{Context as _, Result, bail};
use axum::Router;
use client::session::{SessionOptions, close_session, open_session};
use map_server::{MapServer, ServedMap, ServerOptions, Show};
use nalgebra::Vector3;
use onboard::{MapLink, Outcome, RobotArguments, RobotLink, StopSignal, run_robot_until};
use recognition::{LoadError, LoadedMap};
use sensors::Recording;
use std::net::{Ipv4Addr, SocketAddr, TcpListener};
use std::path::Path;
use std::sync::Arc;
use tokio::runtime::Runtime;

/// Name of the one map of a run, on the network of this process.
pub const MAP: &str = "map";

/// Loads a map into memory, ready to be served.
///
/// # Arguments
/// * `map`: its database, or a release, see [`read_map`].
///
/// # Errors
/// A map that cannot be opened or read; the error names it.
pub fn load_map(map: &Path) -> Result<Arc<LoadedMap>> {
    let loaded = if is_released(map) {
        LoadedMap::from_contents(read_map(map)?.contents)
    } else {
        LoadedMap::read(map)
    };
    let map = loaded.map_err(|error| match error {
        // It names the map.
        LoadError::Store(error) => error.into(),
        error => anyhow::Error::from(error).context(format!("map {}", map.display())),
    })?;
    // Now, and not with the first query, which has a deadline.
    map.aliasing_rate();
    Ok(Arc::new(map))
}

/// Direction of gravity in a map that defines its own frame.
pub fn gravity_in_own_frame(map: &LoadedMap) -> Option<Vector3<f64>> {
    map.info().gravity_in_global.filter(|_| map.info().own_frame)
}

/// Runs a robot through a recording, in a map that is served in this process as long.
///
/// # Errors
/// A recording that cannot be read, a folder that cannot be written, features of another extractor than the map's, a run that ended
/// early.
pub fn run_in_map(
    recording: Recording<'_>,
    robot: &RobotArguments,
    map: &Arc<LoadedMap>,
    stop: &StopSignal,
    show: impl Fn(usize),
) -> Result<Outcome> {
    let mut robot = robot.clone();
    robot.gravity_in_own_frame = gravity_in_own_frame(map);
    robot.mount_as_in(&recording);
    let server = LocalServer::start(vec![(MAP.to_owned(), Arc::clone(map))])?;
    let link = server.link(MAP)?;
    let outcome = run_robot_until(stop, recording, &robot, Some(RobotLink::Open(link.clone())), show);
    server.unlink(&link);
    server.stop()?;
    let outcome = outcome?;
    if let Some(reason) = &outcome.summary.ended_early {
        bail!("ended early: {reason}");
    }
    Ok(outcome)
}

/// A running server with its own runtime and session.
pub struct LocalServer {
    runtime: Runtime,
    session: zenoh::Session,
    server: Option<MapServer>,
    /// Names of the maps.
    names: Vec<String>,
    /// The live map in the browser, where it is shown.
    show: Option<Show>,
    endpoint: String,
}

impl LocalServer {
    /// Serves `maps` on a free port of the loopback interface.
    ///
    /// # Errors
    /// No free port, or an error of Zenoh.
    pub fn start(maps: Vec<(String, Arc<LoadedMap>)>) -> Result<Self> {
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
        let endpoint = free_endpoint()?;
        let options = SessionOptions { listen: vec![endpoint.clone()], ..SessionOptions::default() };
        let session = runtime.block_on(open_session(&options))?;
        let names = maps.iter().map(|(name, _)| name.clone()).collect();
        let maps = maps.into_iter().map(|(name, map)| ServedMap { name, map }).collect();
        let server = runtime.block_on(MapServer::start(session.clone(), maps, ServerOptions::default()))?;
        Ok(Self { runtime, session, server: Some(server), names, show: None, endpoint })
    }

    /// Shows the maps and the robots in the browser, on a free port of the loopback interface, until the server stops.
    ///
    /// # Returns
    /// The address of the page, as `http://127.0.0.1:41234`.
    ///
    /// # Errors
    /// No free port, or an error of Zenoh.
    pub fn show(&mut self) -> Result<String> {
        let server = self.server.as_ref().context("the map server has stopped")?;
        let (address, names) =
            (SocketAddr::from((Ipv4Addr::LOCALHOST, 0)), self.names.iter().map(String::as_str));
        let starting = Show::start(address, &self.session, server, names, Router::new());
        let show = self.runtime.block_on(starting)?;
        let url = format!("http://{}", show.address());
        self.show = Some(show);
        Ok(url)
    }

    /// Offers a run to those who look at the page, with its errors where its recording has a ground truth.
    ///
    /// # Arguments
    /// * `folder`: the output of the run.
    ///
    /// # Errors
    /// A run that cannot be read.
    pub fn show_run(&self, folder: &Path) -> Result<()> {
        let Some(show) = &self.show else { return Ok(()) };
        let run = RunFiles::read(folder, None, None).context("the run cannot be shown")?;
        for sentence in &run.missing {
            eprintln!("{sentence}");
        }
        let served = self.names.first().and_then(|name| self.server.as_ref()?.served(name));
        let gravity = served.and_then(|map| map.info().gravity_in_global);
        show.set_run(&run_tracks(&run, gravity.map_or(Vector3::z(), |gravity| -gravity)));
        Ok(())
    }

    /// The endpoint that robots connect to.
    pub fn endpoint(&self) -> &str {
        &self.endpoint
    }

    /// Opens a session of a robot to this server.
    ///
    /// # Errors
    /// Zenoh's.
    pub fn link(&self, map: &str) -> Result<MapLink> {
        let options = SessionOptions { connect: vec![self.endpoint.clone()], ..SessionOptions::default() };
        let session = self.runtime.block_on(open_session(&options))?;
        Ok(MapLink { session, runtime: self.runtime.handle().clone(), map: map.to_owned() })
    }

    /// Closes a robot's session.
    pub fn unlink(&self, link: &MapLink) {
        self.runtime.block_on(close_session(&link.session));
    }

    /// Stops serving and closes the session.
    ///
    /// # Errors
    /// Zenoh's.
    pub fn stop(mut self) -> Result<()> {
        if let Some(show) = self.show.take() {
            self.runtime.block_on(show.stop());
        }
        let stopped = match self.server.take() {
            Some(server) => self.runtime.block_on(server.stop()),
            None => Ok(()),
        };
        self.runtime.block_on(close_session(&self.session));
        Ok(stopped?)
    }
}

/// An endpoint on the loopback interface whose port is free now.
///
/// # Errors
/// The system has no free port.
pub fn free_endpoint() -> Result<String> {
    let listener = TcpListener::bind("127.0.0.1:0").context("no free port on the loopback interface")?;
    Ok(format!("tcp/{}", listener.local_addr()?))
}
