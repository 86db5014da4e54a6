//! One settings file for a robot: the switches, by their names, in YAML.
//!
//! A switch on the command line overrides the file. Paths are relative to the file.

use clap::parser::ValueSource;
use clap::{Arg, ArgAction, ArgMatches, Command};
use sensors::is_recording;
use serde_json::{Map, Value};
use std::any::TypeId;
use std::ffi::{OsStr, OsString};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Id of the argument that names the settings file.
const SETTINGS: &str = "settings";
/// Id of the switch that writes one.
const WRITE_CONFIG: &str = "write_config";
/// Names less alike than this are no misspellings of each other.
const ALIKE: f64 = 0.6;

/// Why a settings file cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SettingsFileError {
    /// The file cannot be read or written.
    #[error("cannot {verb} settings {}: {source}", path.display())]
    Io {
        /// `read` or `write`.
        verb: &'static str,
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The file is not YAML with names and values.
    #[error("settings {} are not valid YAML (a line for each setting, `name: value`): {source}", path.display())]
    Yaml {
        /// The file.
        path: PathBuf,
        /// The error of the parser.
        source: Box<serde_saphyr::Error>,
    },
    /// It is a folder or a bag, as a recording is.
    #[error("{} is no file with settings; if it is the recording, give it as --sequence {}", path.display(), path.display())]
    Recording {
        /// The folder or bag.
        path: PathBuf,
    },
    /// A name is none of the switches'.
    #[error("settings {}: there is no setting {key:?}{}", path.display(), suggestion(nearest.as_deref()))]
    Unknown {
        /// The file.
        path: PathBuf,
        /// The name.
        key: String,
        /// The switch whose name is most like it.
        nearest: Option<String>,
    },
    /// A value is none that a switch can have.
    #[error("settings {}: {key} is {value}; give {wanted}", path.display())]
    Value {
        /// The file.
        path: PathBuf,
        /// The name.
        key: String,
        /// The value.
        value: String,
        /// What it must be.
        wanted: &'static str,
    },
}

fn suggestion(nearest: Option<&str>) -> String {
    match nearest {
        Some(name) => format!("; did you mean {name:?}?"),
        None => "; --write-config lists all".to_owned(),
    }
}

/// A command line with the settings of its file.
///
/// # Arguments
/// * `command`: with a positional argument `settings`.
/// * `line`: the command line, the program's name first; it is returned as it is where it names no file.
///
/// # Errors
/// [`SettingsFileError`]; values are checked when the result is parsed.
pub fn with_settings(command: &Command, line: Vec<OsString>) -> Result<Vec<OsString>, SettingsFileError> {
    let given = given(command, &line);
    let Some(path) = given.try_get_one::<PathBuf>(SETTINGS).ok().flatten() else { return Ok(line) };
    if is_recording(path) {
        return Err(SettingsFileError::Recording { path: path.clone() });
    }
    let text = files::read_to_string(path).map_err(|source| SettingsFileError::Io {
        verb: "read",
        path: path.clone(),
        source,
    })?;
    // An empty file, or comments only, is null.
    let settings: Option<Map<String, Value>> = serde_saphyr::from_str(&text)
        .map_err(|source| SettingsFileError::Yaml { path: path.clone(), source: Box::new(source) })?;
    let mut all = line.clone();
    for (key, value) in settings.unwrap_or_default() {
        let arg = switches(command).find(|arg| arg.get_long() == Some(&key)).ok_or_else(|| {
            SettingsFileError::Unknown {
                path: path.clone(),
                key: key.clone(),
                nearest: nearest(command, &key),
            }
        })?;
        if is_given(&given, arg) {
            continue;
        }
        all.extend(as_switch(path, arg, &key, value)?);
    }
    Ok(all)
}

/// What a command line says, whatever is wrong or missing in it.
fn given(command: &Command, line: &[OsString]) -> ArgMatches {
    command
        .clone()
        .ignore_errors(true)
        .disable_help_flag(true)
        .disable_version_flag(true)
        .get_matches_from(line)
}

fn is_given(given: &ArgMatches, arg: &Arg) -> bool {
    given.value_source(arg.get_id().as_str()) == Some(ValueSource::CommandLine)
}

/// The switches that a file can have.
fn switches(command: &Command) -> impl Iterator<Item = &Arg> {
    command.get_arguments().filter(|arg| {
        arg.get_long().is_some_and(|long| !["help", "version"].contains(&long))
            && arg.get_id().as_str() != WRITE_CONFIG
    })
}

fn nearest(command: &Command, key: &str) -> Option<String> {
    let key = key.replace('_', "-");
    if let Some(present) = client::renamed_switch(command, &key) {
        return Some(present.to_owned());
    }
    let alike = |name: &str| (strsim::jaro_winkler(name, &key), name.to_owned());
    let names = switches(command).filter_map(Arg::get_long).map(alike);
    let best = names.max_by(|(a, _), (b, _)| a.total_cmp(b))?;
    (best.0 > ALIKE).then_some(best.1)
}

/// A setting as the switch of its name.
fn as_switch(path: &Path, arg: &Arg, key: &str, value: Value) -> Result<Vec<OsString>, SettingsFileError> {
    let wrong = |wanted, value: &Value| SettingsFileError::Value {
        path: path.to_path_buf(),
        key: key.to_owned(),
        value: value.to_string(),
        wanted,
    };
    if matches!(arg.get_action(), ArgAction::SetTrue) {
        return match value {
            Value::Bool(true) => Ok(vec![format!("--{key}").into()]),
            Value::Bool(false) | Value::Null => Ok(Vec::new()),
            other => Err(wrong("true or false", &other)),
        };
    }
    let scalar = |value: &Value| match value {
        Value::String(text) => Ok(text.clone()),
        Value::Number(number) => Ok(number.to_string()),
        other => Err(wrong("a text, a number, or a list of them", other)),
    };
    let mut values = match &value {
        Value::Null => Vec::new(),
        Value::Array(list) => list.iter().map(scalar).collect::<Result<Vec<_>, _>>()?,
        single => vec![scalar(single)?],
    };
    if !matches!(arg.get_action(), ArgAction::Append) && values.len() > 1 {
        values = vec![values.join(",")];
    }
    let folder = path.parent().unwrap_or(Path::new(""));
    let switch = |value: String| {
        let value =
            if is_path(arg) { beside(folder, &value, arg.get_value_delimiter()) } else { value.into() };
        let mut switch = OsString::from(format!("--{key}="));
        switch.push(value);
        switch
    };
    Ok(values.into_iter().map(switch).collect())
}

/// Paths that are relative to a folder; one that is left out stays empty.
///
/// # Arguments
/// * `delimiter`: between paths of one text, where there may be several.
fn beside(folder: &Path, text: &str, delimiter: Option<char>) -> OsString {
    let paths: Vec<&str> = match delimiter {
        Some(delimiter) => text.split(delimiter).collect(),
        None => vec![text],
    };
    let beside =
        |path: &str| if path.is_empty() { OsString::new() } else { folder.join(path).into_os_string() };
    let paths: Vec<OsString> = paths.into_iter().map(beside).collect();
    paths.join(OsStr::new(&delimiter.map(String::from).unwrap_or_default()))
}

fn is_path(arg: &Arg) -> bool {
    arg.get_value_parser().type_id() == TypeId::of::<PathBuf>()
}

/// The text of a settings file: all switches with what they do, those of a command line set, the others as comments with
/// their defaults.
pub fn settings_text(command: &Command, line: &[OsString]) -> String {
    let given = given(command, line);
    let mut text = format!(
        "# Settings of a robot: {} FILE. A switch of the same name overrides a line; paths are relative to this file.\n",
        command.get_name()
    );
    let mut headings: Vec<Option<&str>> = Vec::new();
    for arg in switches(command) {
        if !headings.contains(&arg.get_help_heading()) {
            headings.push(arg.get_help_heading());
        }
    }
    for heading in headings {
        let _ = write!(text, "\n# ---- {} ----\n", heading.unwrap_or("Options"));
        for arg in switches(command).filter(|arg| arg.get_help_heading() == heading) {
            write_setting(&mut text, &given, arg);
        }
    }
    text
}

fn write_setting(text: &mut String, given: &ArgMatches, arg: &Arg) {
    let long = arg.get_long().unwrap_or_default();
    let help = arg.get_help().map(ToString::to_string).unwrap_or_default();
    for line in help.lines() {
        let _ = writeln!(text, "# {line}");
    }
    let choices: Vec<String> =
        arg.get_possible_values().iter().map(|choice| choice.get_name().to_owned()).collect();
    let is_flag = matches!(arg.get_action(), ArgAction::SetTrue);
    if !choices.is_empty() && !is_flag {
        let _ = writeln!(text, "# One of: {}", choices.join(", "));
    }
    if is_given(given, arg) {
        let raw = given.get_raw(arg.get_id().as_str()).into_iter().flatten();
        let text_of = |value: &OsStr| match std::path::absolute(value) {
            // The file may lie in another folder than the one that the path was given in.
            Ok(absolute) if is_path(arg) => scalar(&absolute.to_string_lossy()),
            _ => scalar(&value.to_string_lossy()),
        };
        let values: Vec<String> = raw.map(text_of).collect();
        let value = match (is_flag, values.as_slice()) {
            (true, _) => "true".to_owned(),
            (false, [one]) => one.clone(),
            (false, several) => format!("[{}]", several.join(", ")),
        };
        let _ = writeln!(text, "{long}: {value}");
        return;
    }
    let defaults: Vec<String> =
        arg.get_default_values().iter().map(|value| scalar(&value.to_string_lossy())).collect();
    let value = if is_flag { "false".to_owned() } else { defaults.join(",") };
    let _ = writeln!(text, "#{long}:{}{value}", if value.is_empty() { "" } else { " " });
}

/// A value in YAML: as it is where that is a plain text or a number, else quoted.
fn scalar(value: &str) -> String {
    let is_plain = value.starts_with(|first: char| first.is_ascii_alphabetic() || first == '/')
        && value.chars().all(|each| each.is_ascii_alphanumeric() || "/._-".contains(each))
        && !["true", "false", "null", "yes", "no", "on", "off", "y", "n", "nan", "inf"]
            .contains(&value.to_ascii_lowercase().as_str());
    // A name of digits must stay a text: 007.
    let is_number = value.parse().is_ok_and(|number: f64| number.is_finite() && number.to_string() == value);
    if is_plain || is_number { value.to_owned() } else { Value::from(value).to_string() }
}
