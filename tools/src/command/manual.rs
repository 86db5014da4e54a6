//! `driftless manual`: man pages and shell completions of the three programs, for packages.

use anyhow::{Context as _, Result};
use clap::{Command, CommandFactory as _};
use clap_complete::{Shell, generate_to};
use clap_mangen::Man;
use std::path::{Path, PathBuf};
use std::{fs, iter};

/// Shells whose completions are written.
const SHELLS: [Shell; 3] = [Shell::Bash, Shell::Fish, Shell::Zsh];

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    driftless manual --out share                        share/man/man1, share/completions\n  \
    man -M share/man driftless-build-map\n  \
    source share/completions/driftless.bash             Tab completes commands and switches\n\n\
    Packages of distributions contain both.")]
pub struct Args {
    /// Folder to write to
    #[arg(long, value_name = "DIR", default_value = "share")]
    pub out: PathBuf,
}

/// Runs the command.
///
/// # Errors
/// A file that cannot be written.
pub fn run(args: &Args) -> Result<()> {
    let (pages, completions) = (args.out.join("man/man1"), args.out.join("completions"));
    for folder in [&pages, &completions] {
        fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    }
    for mut program in programs() {
        for shell in SHELLS {
            let name = program.get_name().to_owned();
            generate_to(shell, &mut program, name, &completions)
                .with_context(|| completions.display().to_string())?;
        }
        write_pages(program, &pages)?;
    }
    println!("written to {}", args.out.display());
    Ok(())
}

fn programs() -> [Command; 3] {
    [
        crate::cli::Cli::command(),
        map_server::arguments::Arguments::command().name("map_server"),
        onboard::cli::Arguments::command().name("onboard"),
    ]
}

/// Writes the page of a program, and one for each of its commands: `driftless-build-map.1`.
fn write_pages(mut program: Command, folder: &Path) -> Result<()> {
    program.build();
    let name = program.get_name().to_owned();
    let commands = program.get_subcommands().filter(|command| command.get_name() != "help");
    let commands = commands.map(|command| (format!("{name}-{}", command.get_name()), command));
    for (name, command) in iter::once((name.clone(), &program)).chain(commands) {
        let mut page = Vec::new();
        Man::new(command.clone()).title(name.as_str()).render(&mut page)?;
        let path = folder.join(format!("{name}.1"));
        fs::write(&path, page).with_context(|| path.display().to_string())?;
    }
    Ok(())
}
