//! `driftless simulate`.

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {}

/// Runs the command.
///
/// # Errors
/// It is not written yet.
pub fn run(_args: Args) -> anyhow::Result<()> {
    anyhow::bail!("simulate is not there yet")
}
