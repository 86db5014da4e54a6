//! The folder of one member of a secured fleet, as `driftless fleet init` writes it.
//!
//! It holds a Zenoh configuration, the certificate of the fleet's authority, and the member's certificate and key. Its
//! file names are relative to the folder, which can be copied to any place of any machine.

use super::error::SessionError;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Name of the Zenoh configuration in a member's folder.
pub const CONFIG_FILE: &str = "zenoh.json5";

/// What a member of a fleet may do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Forwards messages between the others.
    Router,
    /// Serves maps and publishes their changes.
    MapServer,
    /// Queries maps, and publishes its own state.
    Robot,
    /// Queries maps, and reads what all publish.
    Operator,
}

impl Role {
    /// The role in words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Router => "router",
            Self::MapServer => "map server",
            Self::Robot => "robot",
            Self::Operator => "operator",
        }
    }
}

/// Name and role of a member, stated in the metadata of its configuration.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Member {
    /// Name of the robot, server or operator.
    pub name: String,
    /// What it may do.
    pub role: Role,
}

impl Member {
    /// Reads whose folder it is.
    ///
    /// # Errors
    /// [`SessionError::NoMember`]: no configuration, or one that states no member.
    pub fn read(folder: &Path) -> Result<Self, SessionError> {
        let failed = |problem: String| SessionError::NoMember { folder: folder.to_owned(), problem };
        let path = folder.join(CONFIG_FILE);
        let text =
            files::read_to_string(&path).map_err(|error| failed(format!("{}: {error}", path.display())))?;
        let config: Value =
            json5::from_str(&text).map_err(|_| failed(format!("{} is not JSON5", path.display())))?;
        let stated = config.pointer("/metadata/driftless").cloned().unwrap_or_default();
        serde_json::from_value(stated).map_err(|_| failed(format!("{} names no member", path.display())))
    }

    /// Checks that the folder is that of a program's role, and that a name given by a switch is the member's.
    ///
    /// # Returns
    /// The member's name.
    ///
    /// # Errors
    /// [`SessionError::NoMember`], [`SessionError::OtherRole`], [`SessionError::OtherName`].
    pub fn expect(
        folder: &Path,
        wanted: Role,
        (switch, given): (&'static str, Option<&str>),
    ) -> Result<String, SessionError> {
        let Self { name, role } = Self::read(folder)?;
        let folder = folder.to_owned();
        if role != wanted {
            return Err(SessionError::OtherRole { folder, role: role.words(), name, wanted: wanted.words() });
        }
        match given.filter(|given| *given != name) {
            Some(given) => Err(SessionError::OtherName { switch, given: given.to_owned(), folder, name }),
            None => Ok(name),
        }
    }
}

/// Makes the files that a configuration names relative to its folder absolute.
pub(super) fn resolve_files(config: &mut Value, folder: &Path) {
    for (_, pointer) in super::checks::FILES {
        if let Some(Value::String(file)) = config.pointer_mut(pointer) {
            *file = absolute(folder, file).display().to_string();
        }
    }
}

fn absolute(folder: &Path, file: &str) -> PathBuf {
    let path = folder.join(file);
    std::path::absolute(&path).unwrap_or(path)
}
