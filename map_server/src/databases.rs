//! The databases behind the served maps: read when the server starts, and again when it is told that they changed.
//!
//! A database is closed again once it was read, so that other programs can write the next version of the map into it while
//! this one is served. A version that cannot be read is never worth the map that is served already: that goes on.

use std::path::PathBuf;
use std::str::FromStr;
use std::sync::Arc;

use anyhow::{Context, bail};
use map::store;
use map_server::{MapServer, ServedMap};
use recognition::LoadedMap;

/// `NAME=DB`
#[derive(Clone, Debug)]
pub struct MapArgument {
    /// The name that robots call the map by.
    pub name: String,
    /// Where it is.
    pub database: PathBuf,
}

impl FromStr for MapArgument {
    type Err = String;

    fn from_str(text: &str) -> Result<MapArgument, String> {
        let Some((name, database)) = text.split_once('=') else {
            return Err("write the map's name and its database as NAME=DB, like hall=maps/hall.db".to_owned());
        };
        protocol::keys::validate_name(name).map_err(|error| error.to_string())?;
        if database.is_empty() {
            return Err(format!("the database of map {name} is missing: write {name}=PATH"));
        }
        Ok(MapArgument { name: name.to_owned(), database: PathBuf::from(database) })
    }
}

/// Reads a map into memory.
pub fn load(argument: &MapArgument) -> anyhow::Result<ServedMap> {
    let MapArgument { name, database } = argument;
    let store = store::open(database).with_context(|| format!("map {name} cannot be served"))?;
    let map = LoadedMap::load(store.as_ref()).with_context(|| format!("map {name} cannot be served"))?;
    tracing::info!(
        name,
        database = %database.display(),
        version = map.info().version,
        keyframes = map.keyframe_count(),
        landmarks = map.landmark_count(),
        "loaded a map"
    );
    if map.damaged_records() > 0 {
        let damaged = map.damaged_records();
        tracing::warn!(name, "{damaged} damaged records were left out; build or import the map again");
    }
    if map.keyframe_count() == 0 {
        tracing::warn!(name, "the map holds no keyframes: nothing will ever match");
    }
    Ok(ServedMap { name: name.clone(), map: Arc::new(map) })
}

/// Reads all databases again and serves those whose version is another one. Says what came of each.
pub async fn reload(server: &MapServer, maps: &[MapArgument]) {
    for argument in maps {
        let name = &argument.name;
        let served = server.version(name);
        let reading = {
            let argument = argument.clone();
            tokio::task::spawn_blocking(move || newer(&argument, served))
        };
        let read = reading.await.unwrap_or_else(|error| Err(error.into()));
        let replaced = match read {
            Ok(Some(map)) => server.replace(name, map, None).await.map_err(anyhow::Error::from),
            Ok(None) => {
                tracing::info!(name, version = served, "the database holds the version that is served");
                continue;
            }
            Err(reason) => {
                let reason = format!("{reason:#}");
                tracing::warn!(name, version = served, reason, "not read again; the map is served as it was");
                continue;
            }
        };
        if let Err(error) = replaced {
            tracing::warn!(name, "the new version is served, but robots were not told: {error:#}");
        }
    }
}

/// The map in a database, if it is of another version than the one that is served.
fn newer(argument: &MapArgument, served: Option<u64>) -> anyhow::Result<Option<Arc<LoadedMap>>> {
    let store = store::open(&argument.database)?;
    if Some(store.info()?.version) == served {
        return Ok(None);
    }
    let map = LoadedMap::load(store.as_ref())?;
    match (map.damaged_records(), map.keyframe_count()) {
        (0, 1..) => Ok(Some(Arc::new(map))),
        (0, 0) => bail!("the new version holds no keyframes"),
        (damaged, _) => {
            bail!("{damaged} records of the new version are damaged; build or import the map again")
        }
    }
}
