//! The command line of `driftless`.

use crate::command::Command;
use crate::old_spellings;
use clap::{CommandFactory as _, Parser};
use std::ffi::OsString;

/// Driftless: localize robots in one shared, drift-free map
#[derive(Debug, Parser)]
#[command(
    name = "driftless",
    version,
    arg_required_else_help = true,
    after_help = "Examples:\n  \
    driftless simulate --out place                                  two recordings: place/map and place/live\n  \
    driftless build-map place/map --map place.db --gravity 0,0,-1   a map of the first\n  \
    driftless run place/live --map place.db --out out               a robot in it, through the second\n  \
    driftless view out --map place.db --open                        what it did\n\n\
    A recording is the first argument of every command that takes one, and a map is --map. `driftless COMMAND --help`\n\
    has examples of each."
)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

impl Cli {
    /// Reads a command line.
    ///
    /// # Arguments
    /// * `line`: the name of the program, then its arguments.
    ///
    /// # Errors
    /// What is wrong with it; of an old spelling, the present one. Also where help or the version is wanted.
    pub fn read(line: impl IntoIterator<Item = OsString>) -> Result<Self, clap::Error> {
        let line: Vec<OsString> = line.into_iter().collect();
        Self::try_parse_from(&line).map_err(|error| {
            client::explain_renamed(&Self::command(), &line, old_spellings::explain(&line, error))
        })
    }
}
