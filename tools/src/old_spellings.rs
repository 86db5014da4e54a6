//! Spellings of the command line that are gone: whoever uses one is told the present one. Switches that only have another name
//! now, of any program, are in `client::explain_renamed`.

use clap::error::{ContextKind, ContextValue, ErrorKind};
use std::ffi::OsString;
use std::path::Path;

/// What was written otherwise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Old {
    /// A switch of this name.
    Switch(&'static str),
    /// An argument without a switch.
    Argument,
}

/// A spelling that is gone.
struct Spelling {
    commands: &'static [&'static str],
    old: Old,
    /// What it is now; `{command}` and `{given}` stand for the command, and for what was given to it.
    now: &'static str,
}

const SPELLINGS: [Spelling; 3] = [
    Spelling {
        commands: &["build-map", "check-calibration", "convert", "info", "play", "run", "track"],
        old: Old::Switch("--sequence"),
        now: "the recording is the first argument, without a switch: driftless {command} REC",
    },
    Spelling {
        commands: &["inspect"],
        old: Old::Switch("--sequence"),
        now: "the recording that the map was built from is --recording: driftless {command} IMAGE --map DB --recording MAP_REC",
    },
    Spelling {
        commands: &["edit-map", "export-colmap", "export-map", "map-info", "publish-map", "view"],
        old: Old::Argument,
        now: "the map is --map: driftless {command} --map {given}",
    },
];

/// The error of a command line, or where it has an old spelling an error that says the present one, in a line.
pub fn explain(line: &[OsString], error: clap::Error) -> clap::Error {
    let command = line.get(1).and_then(|word| word.to_str());
    match (error.kind(), error.get(ContextKind::InvalidArg), command) {
        (ErrorKind::UnknownArgument, Some(ContextValue::String(given)), Some(command)) => {
            present(command, given).unwrap_or(error)
        }
        _ => error,
    }
}

/// Refuses an argument that a command took for something else.
///
/// # Errors
/// Says the present spelling, where the argument is an old one.
pub fn refuse(command: &str, argument: &Path) -> Result<(), clap::Error> {
    present(command, &argument.to_string_lossy()).map_or(Ok(()), Err)
}

fn present(command: &str, given: &str) -> Option<clap::Error> {
    let is_old = |spelling: &&Spelling| {
        let is_given = match spelling.old {
            Old::Switch(name) => given == name,
            Old::Argument => !given.starts_with('-'),
        };
        is_given && spelling.commands.contains(&command)
    };
    let now = SPELLINGS.iter().find(is_old)?.now.replace("{command}", command).replace("{given}", given);
    Some(clap::Error::raw(ErrorKind::UnknownArgument, format!("{given}: {now}\n")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::Cli;
    use clap::CommandFactory as _;

    fn refusal(words: &[&str]) -> clap::Error {
        let line = std::iter::once(&"driftless").chain(words).map(OsString::from);
        Cli::read(line).unwrap_err()
    }

    #[cfg(all(feature = "bags", feature = "releases"))]
    #[test]
    fn old_spellings_end_with_a_line_that_says_the_present_one() {
        for Spelling { commands, old, .. } in &SPELLINGS {
            for command in *commands {
                let (error, expected) = match old {
                    // The page of a run takes an argument, and refuses a map when it looks at it.
                    Old::Argument if *command == "view" => {
                        (refuse(command, Path::new("hall.db")).unwrap_err(), "--map hall.db".to_owned())
                    }
                    Old::Argument => (refusal(&[command, "hall.db"]), "--map hall.db".to_owned()),
                    Old::Switch(name) if *command == "inspect" => {
                        (refusal(&[command, name, "place/map"]), "--recording MAP_REC".to_owned())
                    }
                    Old::Switch(name) => {
                        (refusal(&[command, name, "place/map"]), format!("driftless {command} REC"))
                    }
                };
                let said = error.to_string();
                assert!(said.contains(&expected), "{command}: {said}");
                assert_eq!(said.trim_end().lines().count(), 1, "{command}: {said}");
                assert_eq!(error.exit_code(), 2, "{command}");
            }
        }
    }

    #[test]
    fn what_was_never_a_spelling_is_explained_by_the_parser() {
        let said = refusal(&["run", "place/live", "--sequense", "x"]).to_string();
        assert!(said.contains("unexpected argument") && said.contains("Usage"), "{said}");
    }

    #[test]
    fn recordings_come_first_and_maps_are_a_switch() {
        let mut line = Cli::command();
        line.build();
        for command in line.get_subcommands() {
            for argument in command.get_arguments() {
                let at = format!("{} {}", command.get_name(), argument.get_id());
                assert_ne!(argument.get_long(), Some("sequence"), "{at}");
                let names = argument.get_value_names().unwrap_or_default();
                if names.iter().any(|name| name.split('|').any(|part| part == "REC")) {
                    // One that the first argument was made of, and those that it is tried with, are switches.
                    let is_beside = matches!(argument.get_long(), Some("recording" | "drive"));
                    assert!(argument.get_index() == Some(1) || is_beside, "{at}");
                }
                if names.iter().any(|name| name == "DB") {
                    assert!(matches!(argument.get_long(), Some("map" | "to")), "{at}");
                }
            }
        }
    }
}
