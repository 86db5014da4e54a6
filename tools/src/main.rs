//! The `driftless` command.

use client::without_secrets;
use std::io::IsTerminal as _;
use std::process::ExitCode;
use tools::cli::Cli;
use tracing_subscriber::EnvFilter;

/// Log filter: warnings, without Zenoh's about a network that is still being discovered, but with why it does not connect.
const QUIET: &str = "warn,zenoh=error,zenoh::net::runtime::orchestrator=warn";

fn main() -> ExitCode {
    onboard::stdout::end_quietly_when_closed();
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(QUIET));
    tracing_subscriber::fmt()
        .with_env_filter(without_secrets(filter))
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .init();
    let cli = Cli::read(std::env::args_os()).unwrap_or_else(|error| error.exit());
    match cli.command.run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            if let Some(usage) = error.downcast_ref::<clap::Error>() {
                usage.exit();
            }
            eprintln!("error: {}", client::error_line(error.as_ref()));
            if error.is::<onboard::EndedLost>() {
                ExitCode::from(onboard::EndedLost::EXIT_CODE)
            } else {
                ExitCode::FAILURE
            }
        }
    }
}
