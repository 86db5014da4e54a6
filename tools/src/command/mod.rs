//! The subcommands, one file each: arguments and output. The work itself is in the libraries.

use clap::Subcommand;

pub mod add_features;
pub mod bench;
pub mod build_map;
mod build_report;
pub mod check_calibration;
#[cfg(feature = "releases")]
pub mod checkout;
#[cfg(feature = "bags")]
pub mod convert;
pub mod demo;
pub mod edit_map;
pub mod evaluate;
pub mod export_colmap;
pub mod export_map;
pub mod extract_features;
#[cfg(feature = "secure")]
pub mod fleet;
pub mod hand_in;
pub mod import_colmap;
pub mod import_map;
#[cfg(feature = "bags")]
pub mod info;
pub mod inspect;
#[cfg(not(all(
    feature = "bags",
    feature = "manual",
    feature = "releases",
    feature = "ros",
    feature = "secure",
    feature = "vda5050"
)))]
mod left_out;
pub mod list_sessions;
pub mod localize;
pub mod maintain;
#[cfg(feature = "manual")]
pub mod manual;
pub mod map_info;
pub mod merge_maps;
pub mod montecarlo;
pub mod occupancy_grid;
#[cfg(feature = "ros")]
pub mod play;
pub mod plot;
mod pose_files;
#[cfg(feature = "releases")]
pub mod publish_map;
pub mod query;
#[cfg(feature = "releases")]
pub mod releases;
#[cfg(not(feature = "releases"))]
#[path = "no_releases.rs"]
pub mod releases;
#[cfg(feature = "releases")]
pub mod review_release;
#[cfg(feature = "ros")]
pub mod ros2_map;
pub mod run;
pub mod simulate;
#[cfg(feature = "releases")]
pub mod stages;
#[cfg(not(feature = "releases"))]
#[path = "no_stages.rs"]
pub mod stages;
pub mod track;
#[cfg(feature = "vda5050")]
pub mod vda5050;
pub mod view;
pub mod weights;

/// Commands that a build without a feature leaves out.
macro_rules! left_out {
    ($($module:ident: $feature:tt),+) => {$(
        #[cfg(not(feature = $feature))]
        pub mod $module {
            //! Left out of this build.
            pub use super::left_out::Args;

            /// Refuses the command.
            ///
            /// # Errors
            /// Always, naming the feature.
            pub fn run(_: impl std::borrow::Borrow<Args>) -> anyhow::Result<()> {
                super::left_out::refuse($feature)
            }
        }
    )+};
}
left_out!(checkout: "releases", convert: "bags", fleet: "secure", info: "bags", manual: "manual", play: "ros", publish_map: "releases",
    review_release: "releases", ros2_map: "ros", vda5050: "vda5050");

/// The subcommands of `driftless`.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Simulate, build a map, localize in it, and compare: the whole system in a minute
    Demo(demo::Args),
    /// Simulate a place and two runs through it, as recordings on disk: tracks and features, or images
    Simulate(simulate::Args),
    /// Build a map from a recording, with or without reference poses, or extend one
    BuildMap(build_map::Args),
    /// Add features of a further kind to a map whose images were kept
    AddFeatures(add_features::Args),
    /// Import a plain-text map
    ImportMap(import_map::Args),
    /// Make a map of a COLMAP model and its images
    ImportColmap(import_colmap::Args),
    /// Export a map as plain text
    ExportMap(export_map::Args),
    /// Export a map as a COLMAP model
    ExportColmap(export_colmap::Args),
    /// Write an occupancy grid of a map, for Nav2
    OccupancyGrid(occupancy_grid::Args),
    /// Publish a map on topics of ROS 2: occupancy grid and points
    #[command(name = "ros2-map")]
    Ros2Map(Box<ros2_map::Args>),
    /// Take keyframes or landmarks out of a map, or thin it out
    EditMap(edit_map::Args),
    /// Make one map of two that overlap
    MergeMaps(merge_maps::Args),
    /// Hand in sessions that a robot recorded, to a map server or into a folder
    HandIn(hand_in::Args),
    /// List sessions that robots recorded for a map
    ListSessions(list_sessions::Args),
    /// Keep a map true by the sessions that robots handed in: what is new, what is gone
    Maintain(Box<maintain::Args>),
    /// Publish a map as a release in an object store, from which map servers take it
    PublishMap(publish_map::Args),
    /// List the releases of a map
    ListReleases(releases::ListArgs),
    /// Say what is new, gone or moved between two releases, and where
    DiffReleases(releases::DiffArgs),
    /// Say whether a candidate may be promoted: drives are localized in it and in the live release
    ReviewRelease(Box<review_release::Args>),
    /// Make a candidate the next release
    PromoteRelease(stages::PromoteArgs),
    /// Reject a candidate
    RejectRelease(stages::RejectArgs),
    /// Publish the map of a former release again
    Rollback(releases::RollbackArgs),
    /// Make a map on this machine that of a release
    Checkout(checkout::Args),
    /// Remove old releases, and what no release needs
    CleanReleases(releases::CleanArgs),
    /// Make a key with which releases are signed
    ReleaseKey(releases::KeyArgs),
    /// Print the contents of a map: counts, extent, uncertainties
    MapInfo(map_info::Args),
    /// Query a running map server with the features of an image
    Query(query::Args),
    /// Print the features of an image as a query for a map server (JSON)
    ExtractFeatures(extract_features::Args),
    /// Localize a single image with a running map server
    Localize(localize::Args),
    /// Plot the matches of an image with a map, and print why it was recognized or not
    Inspect(inspect::Args),
    /// List the topics of a bag, and which of them are the sensors of a robot
    Info(info::Args),
    /// Write a recording in another format: EuRoC folder, MCAP, rosbag2
    Convert(convert::Args),
    /// Say whether a calibration agrees with a recording
    CheckCalibration(check_calibration::Args),
    /// Run a robot through a recording, with a map server in the same process
    Run(Box<run::Args>),
    /// Publish a recording as the live sensors of a robot
    Play(play::Args),
    /// Track points through the images of a recording
    Track(track::Args),
    /// Compare an estimated trajectory with the ground truth: ATE, RPE, NEES
    Evaluate(evaluate::Args),
    /// Run the filter many times in simulation and test its consistency (NEES)
    Montecarlo(montecarlo::Args),
    /// Map one recording of a dataset, localize the others in it, and print the table
    Bench(Box<bench::Args>),
    /// Draw the plots of a run
    Plot(plot::Args),
    /// Show a map or a run in the browser
    View(view::Args),
    /// Publish robots as vehicles of VDA 5050 at an MQTT broker
    #[command(name = "vda5050")]
    Vda5050(Box<vda5050::Args>),
    /// Secure a fleet: certificates and access control for servers, robots and operators
    Fleet(fleet::Args),
    /// Install the weights of feature networks, or list the installed ones
    Weights(weights::Args),
    /// Write man pages and shell completions of the programs
    Manual(manual::Args),
}

impl Command {
    /// Runs the subcommand.
    ///
    /// # Errors
    /// The error of the subcommand, as a message for the user.
    pub fn run(self) -> anyhow::Result<()> {
        match self {
            Self::Demo(args) => demo::run(&args),
            Self::Simulate(args) => simulate::run(&args),
            Self::BuildMap(args) => build_map::run(args),
            Self::AddFeatures(args) => add_features::run(&args),
            Self::ImportMap(args) => import_map::run(args),
            Self::ImportColmap(args) => import_colmap::run(args),
            Self::ExportMap(args) => export_map::run(args),
            Self::ExportColmap(args) => export_colmap::run(args),
            Self::OccupancyGrid(args) => occupancy_grid::run(&args),
            Self::Ros2Map(args) => ros2_map::run(args.as_ref()),
            Self::EditMap(args) => edit_map::run(&args),
            Self::MergeMaps(args) => merge_maps::run(&args),
            Self::HandIn(args) => hand_in::run(&args),
            Self::ListSessions(args) => list_sessions::run(&args),
            Self::Maintain(args) => maintain::run(args.as_ref()),
            Self::PublishMap(args) => publish_map::run(&args),
            Self::ListReleases(args) => releases::list(&args),
            Self::DiffReleases(args) => releases::diff(&args),
            Self::Bench(args) => bench::run(args.as_ref()),
            Self::ReviewRelease(args) => review_release::run(args.as_ref()),
            Self::PromoteRelease(args) => stages::promote(&args),
            Self::RejectRelease(args) => stages::reject(&args),
            Self::Rollback(args) => releases::roll_back(&args),
            Self::Checkout(args) => checkout::run(&args),
            Self::CleanReleases(args) => releases::clean(&args),
            Self::ReleaseKey(args) => releases::generate_key(&args),
            Self::MapInfo(args) => map_info::run(args),
            Self::Query(args) => query::run(args),
            Self::ExtractFeatures(args) => extract_features::run(&args),
            Self::Localize(args) => localize::run(&args),
            Self::Info(args) => info::run(&args),
            Self::Convert(args) => convert::run(&args),
            Self::Inspect(args) => inspect::run(&args),
            Self::CheckCalibration(args) => check_calibration::run(&args),
            Self::Run(args) => run::run(&args),
            Self::Play(args) => play::run(&args),
            Self::Track(args) => track::run(&args),
            Self::Evaluate(args) => evaluate::run(&args),
            Self::Montecarlo(args) => montecarlo::run(&args),
            Self::Plot(args) => plot::run(&args),
            Self::View(args) => view::run(&args),
            Self::Vda5050(args) => vda5050::run(args.as_ref()),
            Self::Fleet(args) => fleet::run(args),
            Self::Weights(args) => weights::run(args),
            Self::Manual(args) => manual::run(&args),
        }
    }
}
