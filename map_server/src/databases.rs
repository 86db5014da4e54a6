//! The databases of the served maps: loaded when the server starts, and again on request.
//!
//! A copy of a database is read, so another program can write the next version of the map to it meanwhile. If the new
//! version cannot be loaded, the previous one continues to be served.

use std::path::PathBuf;
use std::str::FromStr;
use std::sync::Arc;

use anyhow::{Context, bail};
use map::store;
use map_server::{MapServer, ServeError, ServedMap};
use protocol::MapIdentity;
use protocol::keys::{NameError, validate_name};
use recognition::LoadedMap;

/// `NAME=DB`
#[derive(Clone, Debug)]
pub struct MapArgument {
    /// Name of the map in its keys.
    pub name: String,
    /// Path of its database.
    pub database: PathBuf,
}

/// Why an argument is not `NAME=DB`.
#[derive(Debug, thiserror::Error)]
pub enum MapArgumentError {
    #[error("write the map's name and its database as NAME=DB, for example hall=maps/hall.db")]
    NoDatabase,
    #[error(transparent)]
    Name(#[from] NameError),
    #[error("the database of map {name} is missing: write {name}=PATH")]
    EmptyPath { name: String },
}

impl FromStr for MapArgument {
    type Err = MapArgumentError;

    fn from_str(text: &str) -> Result<MapArgument, MapArgumentError> {
        let (name, database) = text.split_once('=').ok_or(MapArgumentError::NoDatabase)?;
        validate_name(name)?;
        if database.is_empty() {
            return Err(MapArgumentError::EmptyPath { name: name.to_owned() });
        }
        Ok(MapArgument { name: name.to_owned(), database: PathBuf::from(database) })
    }
}

/// Loads a map into memory.
pub fn load(argument: &MapArgument) -> anyhow::Result<ServedMap> {
    let MapArgument { name, database } = argument;
    let cannot = || format!("map {name} cannot be served");
    let stored = store::load_map(database).with_context(cannot)?;
    let map = LoadedMap::load(stored).with_context(cannot)?;
    tracing::info!(
        name,
        database = %database.display(),
        version = map.info().version,
        identity = %map.identity(),
        keyframes = map.keyframe_count(),
        landmarks = map.landmark_count(),
        "loaded a map"
    );
    if map.damaged_records() > 0 {
        let damaged = map.damaged_records();
        tracing::warn!(name, "skipped {damaged} damaged records; build or import the map again");
    }
    if map.keyframe_count() == 0 {
        tracing::warn!(name, "the map has no keyframes: no query will match");
    }
    Ok(ServedMap { name: name.clone(), map: Arc::new(map) })
}

/// Loads the databases whose version changed and serves the new versions. Logs the result of each.
pub async fn reload(server: &MapServer, maps: &[MapArgument]) {
    for argument in maps {
        let name = &argument.name;
        let Some(present) = server.served(name) else { continue };
        let (served, identity) = (present.info().version, present.identity());
        drop(present);
        let reading = {
            let argument = argument.clone();
            tokio::task::spawn_blocking(move || newer(&argument, served, identity))
        };
        let read = reading.await.unwrap_or_else(|error| Err(error.into()));
        let replaced = match read {
            Ok(Some(map)) => server.replace(name, map, None).await,
            Ok(None) => {
                tracing::info!(name, version = served, "the database has the version that is served");
                continue;
            }
            Err(reason) => {
                let reason = format!("{reason:#}");
                tracing::warn!(
                    name,
                    version = served,
                    reason,
                    "reload failed; the previous version continues to be served"
                );
                continue;
            }
        };
        match replaced {
            Ok(()) => {}
            Err(error @ ServeError::OtherMap { .. }) => {
                tracing::warn!(
                    name,
                    version = served,
                    "reload refused; the previous version continues to be served: {error}"
                );
            }
            Err(error) => {
                tracing::warn!(
                    name,
                    "the new version is served, but its notice was not published: {error:#}"
                );
            }
        }
    }
}

/// The map in a database, if its version or its identity differs from the served one.
fn newer(
    argument: &MapArgument,
    served: u64,
    identity: MapIdentity,
) -> anyhow::Result<Option<Arc<LoadedMap>>> {
    let stored = store::load_map(&argument.database)?;
    let info = &stored.contents.info;
    if (info.version, info.identity) == (served, Some(identity)) {
        return Ok(None);
    }
    let map = LoadedMap::load(stored)?;
    match (map.damaged_records(), map.keyframe_count()) {
        (0, 1..) => Ok(Some(Arc::new(map))),
        (0, 0) => bail!("the new version has no keyframes"),
        (damaged, _) => {
            bail!("{damaged} records of the new version are damaged; build or import the map again")
        }
    }
}
