//! The program `driftless`, run by tests.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

/// Runs it to its end.
pub fn driftless(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_driftless")).args(arguments).output().unwrap()
}

/// What a command that succeeds prints as JSON.
pub fn json_of(arguments: &[&str]) -> Value {
    let output = driftless(&[arguments, &["--json"]].concat());
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// Standard error of a command that fails.
pub fn complaint_of(arguments: &[&str]) -> String {
    let output = driftless(arguments);
    assert!(!output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
    String::from_utf8(output.stderr).unwrap()
}

/// A path as an argument.
pub fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}
