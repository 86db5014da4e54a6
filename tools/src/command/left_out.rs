//! Commands that a build leaves out: they name the feature that brings them.

use anyhow::bail;

/// The arguments of a command that this program was built without, whatever they are.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// The arguments of the command in a program with it
    #[arg(value_name = "ARGUMENT", trailing_var_arg = true, allow_hyphen_values = true)]
    arguments: Vec<String>,
}

/// Refuses a command.
///
/// # Errors
/// Always, naming the feature.
pub fn refuse(feature: &str) -> anyhow::Result<()> {
    bail!(
        "this program was built without the feature `{feature}`, which this command needs: build it with `cargo build \
         --release -p driftless-tools`, then repeat the command"
    )
}
