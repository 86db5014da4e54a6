//! The `driftless` command.

use clap::Parser;
use std::io::IsTerminal as _;
use std::process::ExitCode;
use tools::command::Command;

/// Driftless: localize robots in one shared, drift-free map
#[derive(Debug, Parser)]
#[command(name = "driftless", version, arg_required_else_help = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

fn main() -> ExitCode {
    onboard::stdout::end_quietly_when_closed();
    tracing_subscriber::fmt()
        .with_env_filter(
            tracing_subscriber::EnvFilter::try_from_default_env()
                .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new("warn,zenoh=error")),
        )
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .init();
    match Cli::parse().command.run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            if error.is::<onboard::EndedLost>() {
                ExitCode::from(onboard::EndedLost::EXIT_CODE)
            } else {
                ExitCode::FAILURE
            }
        }
    }
}
