//! Maps that a command makes again and again: in place of its own ones only.

use anyhow::{Result, bail};
use map::store::{StoreError, load_map};
use std::path::Path;

/// Refuses to replace a map that another command made.
///
/// # Arguments
/// * `command`: what made the maps that may be replaced, as they state it themselves (`created_by`).
///
/// # Returns
/// Whether there is such a map.
///
/// # Errors
/// A map of another command, or one that cannot be read.
pub(crate) fn is_replaceable(database: &Path, command: &str) -> Result<bool> {
    let made_by = match load_map(database) {
        Ok(stored) => stored.contents.info.created_by,
        // Nothing is lost, and what is no map is not written over.
        Err(StoreError::Missing { .. } | StoreError::Unfinished { .. } | StoreError::NotAMap { .. }) => {
            return Ok(false);
        }
        Err(error) => return Err(error.into()),
    };
    if made_by != command {
        bail!(
            "{} is a map that was made by {made_by}, not by {command}, and is not replaced: name another folder with \
             --out, or remove it",
            database.display()
        );
    }
    Ok(true)
}

#[cfg(test)]
mod tests {
    use super::*;
    use map::store::save_map;
    use map::{MapContents, MapMetadata};
    use protocol::DescriptorKind;

    #[test]
    fn a_command_replaces_its_own_maps_and_no_others() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.db");
        assert!(!is_replaceable(&path, "driftless demo").unwrap());
        let info = MapMetadata::new("room", "driftless demo", DescriptorKind::Binary, 32);
        save_map(&path, &MapContents::empty(info), false).unwrap();
        assert!(is_replaceable(&path, "driftless demo").unwrap());
        let refused = is_replaceable(&path, "driftless bench").unwrap_err().to_string();
        assert!(refused.contains("was made by driftless demo") && refused.contains("--out"), "{refused}");
        assert!(!is_replaceable(folder.path(), "driftless bench").unwrap());
    }
}
