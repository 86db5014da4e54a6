//! The command line of `map_server`.

use std::ffi::OsString;
use std::net::SocketAddr;
use std::path::PathBuf;

use anyhow::bail;
use clap::{CommandFactory as _, Parser};
use client::{SessionArguments, explain_renamed};
use monitoring::LogFormat;
use releases::ReleaseKey;

use crate::byte_size::ByteSize;
use crate::cells::CellChoice;
use crate::map_argument::MapArgument;

const EXAMPLES: &str = "\
Examples:
  Serve one map to programs on this machine:
    map_server --map hall=maps/hall.db

  Serve two maps to the robots of the fleet `north` in the local network:
    map_server --map hall=maps/hall.db --map yard=maps/yard.db --listen tcp/0.0.0.0:7447 --namespace north

  Connect to a Zenoh router instead of listening:
    map_server --map hall=maps/hall.db --connect tcp/10.0.0.1:7447

  Show the map and the robots in the browser:
    map_server --map hall=maps/hall.db --http 127.0.0.1:8080

  Serve the newest release of a map, and follow new ones (see `driftless publish-map`):
    map_server --map city=s3://bucket/city --cache /var/cache/driftless

  Serve what is proposed beside it, to robots that try it (see `driftless publish-map --stage candidate`):
    map_server --map city-next=s3://bucket/city@candidate --connect tcp/10.0.0.1:7447

  Serve it by several servers that share its cells, each cell at two of them (see the page Releases of the book):
    map_server --map city=s3://bucket/city --cells auto --connect tcp/10.0.0.1:7447
    map_server --map city=s3://bucket/city --cells auto --connect tcp/10.0.0.1:7447 --memory 8G

  Then, in another shell:
    driftless query --map hall --features frame.csv        one image against the map
    onboard --sequence REC --map hall --out out            a recorded run, localized

  Serve a new version of a map without a restart; robots are notified and keep their pose:
    driftless import-map text --map maps/hall.db --force   or build-map, into the served database
    kill -HUP PID                                          of the server, which reloads its databases

Maps are built by `driftless build-map` or imported by `driftless import-map`. A map is loaded when the server starts,
and at SIGHUP if its version changed; if that fails, the previous version continues to be served and the log says why.
Another map than the served one (see `driftless map-info`: identity) is not loaded at SIGHUP: restart the server for it.
Ctrl-C or SIGTERM stops the server gracefully.";

/// Log filter: of Zenoh, warnings, and who was let in or refused.
const QUIET: &str = "info,zenoh=warn,zenoh_link_tls=debug,zenoh::net::routing::interceptor=info";

/// Serves maps to robots over Zenoh: matches images with keyframes and estimates where they were taken.
#[derive(Parser, Debug)]
#[command(version, after_long_help = EXAMPLES, after_help = "Use --help for examples.")]
pub struct Arguments {
    /// A map to serve: its name in keys and its database, or the folder or URL of its releases (/srv/city, s3://bucket/city; see
    /// `driftless publish-map`), with @7 for release 7, and @candidate for the newest candidate or, where none is open, the live
    /// release. A folder that may be away when the server starts is given as file:///srv/city. May be given several times.
    #[arg(long = "map", value_name = "NAME=DB|FOLDER|URL", required = true)]
    pub maps: Vec<MapArgument>,

    /// Folder for what is fetched of releases: a restart serves it when the store is away [default: driftless/releases in
    /// the user's cache folder].
    #[arg(long, value_name = "DIR")]
    pub cache: Option<PathBuf>,

    /// Folder of this server's database: which version of each map it served last, so that an older one is noticed after a
    /// restart. Each server has its own [default: driftless/map_server in the user's folder of states].
    #[arg(long, value_name = "DIR")]
    pub state: Option<PathBuf>,

    /// Look for new releases after this time, s.
    #[arg(long, value_name = "SECONDS", default_value_t = 30, value_parser = clap::value_parser!(u64).range(1..))]
    pub watch_releases: u64,

    /// Take only releases that are signed with this key: a file of driftless release-key or minisign, or its line.
    #[arg(long, value_name = "FILE|KEY")]
    pub release_key: Option<ReleaseKey>,

    /// Serve these cells of maps from releases, and leave the others to other servers: numbers like 0-3,7 (see
    /// `driftless list-releases --cells`), or auto for a share of them, which changes as servers come and go.
    #[arg(long, value_name = "CELLS|auto")]
    pub cells: Option<CellChoice>,

    /// With --cells auto: have each cell at so many servers.
    #[arg(long, value_name = "N", default_value_t = 2, requires = "cells", value_parser = clap::value_parser!(u16).range(1..))]
    pub replicas: u16,

    /// With --cells: memory that loaded cells may take, like 8G or 512M. Further cells are on disk, in --cache, and loaded when they
    /// are asked for; those that were not asked for longest give way [default: all cells are in memory].
    #[arg(long, value_name = "SIZE", requires = "cells")]
    pub memory: Option<ByteSize>,

    /// Take sessions that robots hand in, into this folder: for `driftless maintain`
    ///
    /// One server of a map takes them.
    #[arg(long, value_name = "DIR")]
    pub inbox: Option<PathBuf>,

    /// What all sessions in the inbox may take, like 10G.
    #[arg(long, value_name = "SIZE", default_value = "10G", requires = "inbox")]
    pub inbox_limit: ByteSize,

    /// What the sessions of one robot may take there.
    #[arg(long, value_name = "SIZE", default_value = "1G", requires = "inbox")]
    pub inbox_robot_limit: ByteSize,

    /// Take only sessions that are signed: folder with the public key NAME.pub of each robot, made by `driftless release-key`.
    #[arg(long, value_name = "DIR", requires = "inbox")]
    pub robot_keys: Option<PathBuf>,

    /// How the server is connected [default: --listen tcp/127.0.0.1:7447].
    #[command(flatten)]
    pub session: SessionArguments,

    /// Name of this server among others [default: that of its certificate, or the id of its Zenoh session].
    #[arg(long, value_name = "NAME")]
    pub name: Option<String>,

    /// Queries answered at the same time [default: the number of processors].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub workers: Option<u16>,

    /// Log filter: error, warn, info, debug, or per module, like map_server=debug,zenoh=warn.
    #[arg(long, value_name = "FILTER", default_value = QUIET)]
    pub log: String,

    /// Format of the log: text for people, json for programs, one object a line.
    #[arg(long, value_name = "FORMAT", default_value_t)]
    pub log_format: LogFormat,

    /// Address of an HTTP server of metrics (/metrics, for Prometheus) and health (/health), for example
    /// 127.0.0.1:9464. It knows no users: use an address that only operators reach.
    #[arg(long, value_name = "ADDRESS:PORT")]
    pub monitoring: Option<SocketAddr>,

    /// Address of an HTTP server of the live map in the browser (/), for example 127.0.0.1:8080, with metrics and health
    /// beside it. It knows no users: an address other than loopback shows the map and all robots to everybody who reaches it.
    #[arg(long, value_name = "ADDRESS:PORT")]
    pub http: Option<SocketAddr>,
}

impl Arguments {
    /// The switches of the command line. Ends the program where they are wrong or help is wanted.
    pub fn read() -> Self {
        let line: Vec<OsString> = std::env::args_os().collect();
        Self::try_parse_from(&line)
            .unwrap_or_else(|error| explain_renamed(&Self::command(), &line, error).exit())
    }

    /// The maps of which this server has some cells, and those that it has as a whole.
    ///
    /// # Errors
    /// `--cells` without a map from releases.
    pub fn maps_by_cells(&self) -> anyhow::Result<(Vec<&MapArgument>, Vec<&MapArgument>)> {
        let (by_cells, whole): (Vec<_>, Vec<_>) =
            self.maps.iter().partition(|map| self.cells.is_some() && map.is_released());
        if self.cells.is_some() && by_cells.is_empty() {
            bail!(
                "--cells is for maps from releases (--map NAME=FOLDER or NAME=URL), and there is none: publish it with driftless publish-map"
            );
        }
        Ok((by_cells, whole))
    }
}
