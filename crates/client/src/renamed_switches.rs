//! Switches that had other names: whoever uses an old one is told the present one.

use clap::Command;
use clap::error::{ContextKind, ContextValue, ErrorKind};
use std::ffi::OsString;

/// Old and present names, without dashes. A command that never had the present one has never had the old one.
const RENAMED: [(&str, &str); 15] = [
    ("accelerometer-bias-sigma", "sigma-accelerometer-bias"),
    ("config", "zenoh-config"),
    ("gyroscope-bias-sigma", "sigma-gyroscope-bias"),
    ("keep-poses", "no-refine-poses"),
    ("map-sigma", "sigma-map"),
    ("match-sigma", "sigma-match"),
    ("picture", "svg"),
    ("pixel-sigma", "sigma-pixel"),
    ("reference-p-sigma", "sigma-reference-p"),
    ("reference-theta-sigma", "sigma-reference-theta"),
    ("settings", "estimator-config"),
    ("skip-after-fix", "skip-after-initialization"),
    ("start-sigma", "sigma-start"),
    ("state-landmarks", "slam-features"),
    ("track-sigma", "sigma-track"),
];

/// The present name of a switch of a command that had another one.
///
/// # Arguments
/// * `old`: without dashes in front.
pub fn renamed_switch(command: &Command, old: &str) -> Option<&'static str> {
    let (_, present) = RENAMED.iter().find(|(name, _)| *name == old)?;
    command.get_arguments().any(|argument| argument.get_long() == Some(present)).then_some(present)
}

/// The error of a command line, or where it uses the old name of a switch an error that says the present one, in a line.
///
/// # Arguments
/// * `program`: what the line was parsed by.
/// * `line`: the name of the program, then its arguments.
pub fn explain_renamed(program: &Command, line: &[OsString], error: clap::Error) -> clap::Error {
    let (ErrorKind::UnknownArgument, Some(ContextValue::String(given))) =
        (error.kind(), error.get(ContextKind::InvalidArg))
    else {
        return error;
    };
    let words = line.iter().skip(1).filter_map(|word| word.to_str());
    let command = words.fold(program, |command, word| command.find_subcommand(word).unwrap_or(command));
    let Some(present) = given.strip_prefix("--").and_then(|old| renamed_switch(command, old)) else {
        return error;
    };
    clap::Error::raw(ErrorKind::UnknownArgument, format!("{given}: the switch is --{present}\n"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Arg;

    fn refusal(line: &str) -> String {
        let switch = |name: &'static str| Arg::new(name).long(name);
        let program = Command::new("robot")
            .arg(switch("zenoh-config"))
            .subcommand(Command::new("run").arg(switch("estimator-config")).arg(switch("svg")));
        let line: Vec<OsString> = line.split(' ').map(OsString::from).collect();
        let error = program.clone().try_get_matches_from(&line).unwrap_err();
        explain_renamed(&program, &line, error).to_string()
    }

    #[test]
    fn the_present_name_is_said_where_the_command_has_it() {
        for (line, said) in [
            ("robot --config z.json5", "--config: the switch is --zenoh-config\n"),
            ("robot run --settings a.yaml", "--settings: the switch is --estimator-config\n"),
            ("robot run --svg a.svg --picture=b.svg", "--picture: the switch is --svg\n"),
        ] {
            assert!(refusal(line).ends_with(said), "{line}: {}", refusal(line));
            assert_eq!(refusal(line).trim_end().lines().count(), 1, "{line}");
        }
        for line in ["robot --picture a.svg", "robot run --config z.json5", "robot run --sequense a"] {
            assert!(refusal(line).contains("unexpected argument"), "{line}: {}", refusal(line));
        }
    }
}
