//! `driftless evaluate`.

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {}

/// Runs the command.
///
/// # Errors
/// It is not written yet.
pub fn run(_args: Args) -> anyhow::Result<()> {
    anyhow::bail!("evaluate is not there yet")
}
