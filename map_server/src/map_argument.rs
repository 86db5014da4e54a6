//! A map to serve, as the command line names it.

use std::path::Path;
use std::str::FromStr;

use map::store;
use protocol::keys::{NameError, validate_name};
use releases::ReleasePlace;

/// `NAME=DB`, `NAME=FOLDER` or `NAME=URL`
#[derive(Clone, Debug)]
pub struct MapArgument {
    /// Name of the map in its keys.
    pub name: String,
    /// Path of its database, or folder or URL of its releases, with `@RELEASE` for another one than the newest.
    pub place: String,
}

/// Why an argument is not `NAME=DB`.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MapArgumentError {
    /// There is no `=`.
    #[error("write the map's name and its database as NAME=DB, for example hall=maps/hall.db")]
    NoDatabase,
    /// The name cannot be part of a key.
    #[error(transparent)]
    Name(#[from] NameError),
    /// Nothing follows the `=`.
    #[error("the database of map {name} is missing: write {name}=PATH")]
    EmptyPath {
        /// Name of the map.
        name: String,
    },
}

impl FromStr for MapArgument {
    type Err = MapArgumentError;

    fn from_str(text: &str) -> Result<MapArgument, MapArgumentError> {
        let (name, place) = text.split_once('=').ok_or(MapArgumentError::NoDatabase)?;
        validate_name(name)?;
        if place.is_empty() {
            return Err(MapArgumentError::EmptyPath { name: name.to_owned() });
        }
        Ok(MapArgument { name: name.to_owned(), place: place.to_owned() })
    }
}

impl MapArgument {
    /// Its releases, and which of them: `city=s3://bucket/city`, `city=/srv/city@candidate`.
    pub fn releases(&self) -> ReleasePlace {
        ReleasePlace::from(self.place.as_str())
    }

    /// Whether its place is one of releases: a URL, or a folder that was published to. One that holds a map besides is a database.
    pub fn is_released(&self) -> bool {
        let ReleasePlace { url, .. } = self.releases();
        self.releases().is_released() && !store::is_map(Path::new(&url))
    }
}
