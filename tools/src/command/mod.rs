//! The subcommands, one file each: its arguments and what it prints. The work itself is in the libraries.

use clap::Subcommand;

pub mod build_map;
pub mod demo;
pub mod evaluate;
pub mod export_map;
pub mod import_map;
pub mod inspect;
pub mod localize;
pub mod map_info;
pub mod montecarlo;
pub mod plot;
pub mod query;
pub mod run;
pub mod simulate;
pub mod track;
pub mod weights;

/// What `driftless` can do.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Simulate, build a map, localize in it, and compare: the whole system in a minute
    Demo(demo::Args),
    /// Simulate a place and two runs through it, as sequences on disk
    Simulate(simulate::Args),
    /// Build a map from a reference sequence
    BuildMap(build_map::Args),
    /// Import a plain-text map
    ImportMap(import_map::Args),
    /// Export a map as plain text
    ExportMap(export_map::Args),
    /// Print what a map holds
    MapInfo(map_info::Args),
    /// Ask a running map server
    Query(query::Args),
    /// Ask a running map server where an image was taken
    Localize(localize::Args),
    /// Draw what of an image matched what of a map, and say why it was recognized or not
    Inspect(inspect::Args),
    /// Run a robot through a recording, with a map server in the same process
    Run(run::Args),
    /// Track points through the images of a recording
    Track(track::Args),
    /// Compare an estimated trajectory with the truth
    Evaluate(evaluate::Args),
    /// Run the filter many times in simulation and judge whether its errors are what it says
    Montecarlo(montecarlo::Args),
    /// Draw the pictures of a run
    Plot(plot::Args),
    /// Get the weights of networks, or list which are there
    Weights(weights::Args),
}

impl Command {
    /// Runs the subcommand.
    ///
    /// # Errors
    /// Whatever the subcommand could not do, in words for the person at the shell.
    pub fn run(self) -> anyhow::Result<()> {
        match self {
            Self::Demo(args) => demo::run(&args),
            Self::Simulate(args) => simulate::run(&args),
            Self::BuildMap(args) => build_map::run(args),
            Self::ImportMap(args) => import_map::run(args),
            Self::ExportMap(args) => export_map::run(args),
            Self::MapInfo(args) => map_info::run(args),
            Self::Query(args) => query::run(args),
            Self::Localize(args) => localize::run(&args),
            Self::Inspect(args) => inspect::run(&args),
            Self::Run(args) => run::run(&args),
            Self::Track(args) => track::run(&args),
            Self::Evaluate(args) => evaluate::run(&args),
            Self::Montecarlo(args) => montecarlo::run(&args),
            Self::Plot(args) => plot::run(&args),
            Self::Weights(args) => weights::run(args),
        }
    }
}
