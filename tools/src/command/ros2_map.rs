//! `driftless ros2-map`: a map on topics of ROS 2.

use super::occupancy_grid::GridArguments;
use crate::map_place::read_map;
use crate::map_topics::{MAX_POINTS, grid_message, points_message};
use anyhow::{Context as _, Result, bail};
use client::SessionOptions;
use client::session::{DEFAULT_ENDPOINT, SessionMode, close_session, open_session};
use map_io::occupancy::OccupancyGrid;
use onboard::StopSignal;
use onboard::stop::NetworkRuntime;
use ros2::{Node, NodeOptions, Qos};
use std::path::PathBuf;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Example:\n  driftless ros2-map --map hall.db --camera-height 0.4\n\n\
    Publishes /map (nav_msgs/OccupancyGrid) and /map_points (sensor_msgs/PointCloud2), latched, until Ctrl-C.")]
pub struct Args {
    /// Database of the map, or its releases: a folder or URL, with @7 for release 7, or @candidate
    #[arg(long, value_name = "DB|URL")]
    pub map: PathBuf,
    /// Zenoh router of ROS 2 (rmw_zenohd)
    #[arg(long, value_name = "ENDPOINT", default_value = DEFAULT_ENDPOINT)]
    pub ros2_connect: String,
    /// ROS_DOMAIN_ID of the other nodes
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub ros2_domain: u32,
    /// Namespace of node and topics [default: none]
    #[arg(long, value_name = "NAME", default_value = "", hide_default_value = true)]
    pub ros2_namespace: String,
    /// Name of the frame of the map
    #[arg(long, value_name = "NAME", default_value = "map")]
    pub frame: String,
    /// Do not publish the grid: another map server does
    #[arg(long)]
    pub points_only: bool,
    /// Which landmarks are obstacles of the grid
    #[command(flatten)]
    pub grid: GridArguments,
}

/// Runs the command.
///
/// # Errors
/// A map that cannot be read or has no such grid, a session that cannot be opened.
pub fn run(args: &Args) -> Result<()> {
    let map = read_map(&args.map)?.contents;
    let points = points_message(&map, &args.frame);
    if map.landmarks.len() > MAX_POINTS {
        eprintln!("{} of {} landmarks are published", points.width, map.landmarks.len());
    }
    let grid = if args.points_only {
        None
    } else {
        Some(grid_message(&OccupancyGrid::of_map(&map, &args.grid.settings()?)?, &args.frame))
    };
    let stop = StopSignal::on_interrupt().context("signals cannot be handled")?;
    let runtime = NetworkRuntime::new()?;
    let options = SessionOptions {
        connect: vec![args.ros2_connect.clone()],
        mode: Some(SessionMode::Client),
        ..SessionOptions::default()
    };
    let opened = runtime.block_on(stop.until(open_session(&options)));
    let Some(session) = opened else { bail!("interrupted before {} answered", args.ros2_connect) };
    let session = session.context("the Zenoh session cannot be opened")?;
    let publishers = runtime.block_on(async {
        let node = NodeOptions {
            domain: args.ros2_domain,
            namespace: args.ros2_namespace.clone(),
            name: "driftless_map".to_owned(),
        };
        let node = Node::new(session.clone(), node).await?;
        let of_points = node.publisher("map_points", Qos::latched()).await?;
        of_points.publish(&points).await?;
        let of_grid = node.publisher("map", Qos::latched()).await?;
        if let Some(grid) = &grid {
            of_grid.publish(grid).await?;
        }
        anyhow::Ok((node, of_points, of_grid))
    })?;
    println!("map_points: {} points", points.width);
    if let Some(grid) = &grid {
        println!("map: {} x {} cells", grid.info.width, grid.info.height);
    }
    stop.wait();
    drop(publishers);
    runtime.block_on(close_session(&session));
    Ok(())
}
