//! What a configuration may ask for: all that this build of Zenoh can do, and nothing that it would ignore.

use super::endpoint;
use super::error::SessionError;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Files that a configuration may name.
pub(super) const FILES: [(&str, &str); 6] = [
    ("root_ca_certificate", "/transport/link/tls/root_ca_certificate"),
    ("listen_certificate", "/transport/link/tls/listen_certificate"),
    ("listen_private_key", "/transport/link/tls/listen_private_key"),
    ("connect_certificate", "/transport/link/tls/connect_certificate"),
    ("connect_private_key", "/transport/link/tls/connect_private_key"),
    ("dictionary_file", "/transport/auth/usrpwd/dictionary_file"),
];

const PUBKEY: &str =
    "this build authenticates by certificates (TLS) and by user and password, not by public keys: remove it";
const SHARED_MEMORY: &str = "this build has no shared memory: remove it";
const COMPRESSION: &str = "this build has no compression: remove it";
const PLUGINS: &str = "plugins are loaded by zenohd only: remove it";
const MULTILINK: &str = "this build has one link per transport: remove it";
const STATISTICS: &str = "this build keeps no statistics by key: remove it";

/// Whether a value asks for something.
type Asks = fn(&Value) -> bool;

/// Refuses what Zenoh would ignore without a word.
pub(super) fn check_features(path: &Path, config: &Value) -> Result<(), SessionError> {
    let features: [(&str, &'static str, Asks); 9] = [
        ("/transport/auth/pubkey", PUBKEY, holds_a_value),
        ("/transport/shared_memory/enabled", SHARED_MEMORY, is_true),
        ("/transport/unicast/compression/enabled", COMPRESSION, is_true),
        ("/transport/multicast/compression/enabled", COMPRESSION, is_true),
        ("/transport/unicast/max_links", MULTILINK, |value| value.as_u64().is_some_and(|links| links > 1)),
        ("/plugins", PLUGINS, holds_a_value),
        ("/plugins_loading/enabled", PLUGINS, is_true),
        ("/stats", STATISTICS, holds_a_value),
        (
            "/access_control/enabled",
            "access control that is disabled protects nothing: remove the section",
            |value| *value == Value::Bool(false),
        ),
    ];
    for (pointer, why, asks) in features {
        if let Some(value) = config.pointer(pointer).filter(|value| asks(value)) {
            // Not what is in a section, which may be secret.
            let value = if value.is_object() { "{...}".to_owned() } else { value.to_string() };
            let key = pointer.trim_start_matches('/').to_owned();
            return Err(SessionError::NotInThisBuild { path: path.to_owned(), key, value, why });
        }
    }
    Ok(())
}

fn is_true(value: &Value) -> bool {
    *value == Value::Bool(true)
}

fn holds_a_value(value: &Value) -> bool {
    match value {
        Value::Null => false,
        Value::Object(fields) => fields.values().any(holds_a_value),
        Value::Array(items) => items.iter().any(holds_a_value),
        _ => true,
    }
}

/// Checks that the files which a configuration names can be read.
pub(super) fn check_files(config: &Value) -> Result<(), SessionError> {
    for (key, pointer) in FILES {
        if let Some(file) = config.pointer(pointer).and_then(Value::as_str) {
            let file = PathBuf::from(file);
            files::open(&file).map_err(|problem| SessionError::MissingFile { key, file, problem })?;
        }
    }
    Ok(())
}

/// All endpoints below a key of a configuration, in whatever form they are written there.
pub(super) fn endpoints<'a>(config: &'a Value, key: &str) -> Vec<&'a str> {
    fn collect<'a>(value: &'a Value, into: &mut Vec<&'a str>) {
        match value {
            Value::String(endpoint) => into.push(endpoint),
            Value::Array(items) => items.iter().for_each(|item| collect(item, into)),
            // By mode, or a group with a strategy.
            Value::Object(fields) => {
                let parts = fields.iter().filter(|(name, _)| *name != "strategy");
                parts.for_each(|(_, part)| collect(part, into));
            }
            _ => {}
        }
    }
    let mut found = Vec::new();
    if let Some(value) = config.pointer(key) {
        collect(value, &mut found);
    }
    found
}

/// Checks the endpoints of a configuration.
pub(super) fn check_endpoints(config: &Value, encrypted: bool) -> Result<(), SessionError> {
    for (key, what) in super::ENDPOINTS {
        for value in endpoints(config, key) {
            endpoint::check(what, value)?;
            if encrypted && endpoint::protocol(value) != "tls" {
                return Err(SessionError::NotEncrypted { endpoint: value.to_owned() });
            }
        }
    }
    Ok(())
}
