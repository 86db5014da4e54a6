//! `driftless weights` in a program without networks that need files of weights: names the build that has them.

use anyhow::bail;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "This program was built without XFeat and R2D2. Build it with them:\n  \
    cargo build --release -p driftless-tools --features neural\n\n\
    Then:\n  \
    driftless weights                          list the installed weights\n  \
    driftless weights xfeat                    install the weights of XFeat\n\n\
    The weights of edgepoint2-1 are part of every program.")]
pub struct Args {
    /// The arguments of the command in a program with networks
    #[arg(value_name = "ARGUMENT", trailing_var_arg = true, allow_hyphen_values = true)]
    arguments: Vec<String>,
}

/// Runs the command.
///
/// # Errors
/// Always: this program has no networks.
pub fn run(_: Args) -> anyhow::Result<()> {
    bail!(
        "this program was built without XFeat and R2D2: build it with `cargo build --release -p driftless-tools --features \
         neural`, then repeat the command"
    )
}
