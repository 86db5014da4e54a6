//! The databases and releases of the served maps: loaded when the server starts, and again on request.
//!
//! Another program can write the next version of a map meanwhile. If the new version cannot be loaded, the previous one continues
//! to be served.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, ensure};
use map::store;
use map_server::map_argument::MapArgument;
use map_server::{MapServer, ServeError, ServedMap};
use recognition::{AliasingRate, LoadedMap};
use releases::ReleaseKey;

use crate::background::in_background;
use crate::released::ReleasedMap;

/// Where a served map comes from.
#[derive(Clone, Debug)]
pub struct MapSource {
    /// Name of the map in its keys.
    pub name: String,
    origin: Origin,
}

#[derive(Clone, Debug)]
enum Origin {
    Database(PathBuf),
    Releases(ReleasedMap),
}

impl MapSource {
    /// Opens the source that an argument names; a map is not read yet.
    ///
    /// # Arguments
    /// * `cache`: folder for what is fetched of releases, one folder a map in it.
    /// * `key`: releases must be signed with it.
    ///
    /// # Errors
    /// An invalid URL, a cache that cannot be written.
    pub fn open(argument: &MapArgument, cache: &Path, key: Option<&ReleaseKey>) -> anyhow::Result<MapSource> {
        let MapArgument { name, place } = argument;
        let origin = if argument.is_released() {
            let released = ReleasedMap::open(&argument.releases(), &cache.join(name), key);
            Origin::Releases(released.with_context(|| format!("map {name} cannot be served"))?)
        } else {
            Origin::Database(PathBuf::from(place))
        };
        Ok(MapSource { name: name.clone(), origin })
    }

    /// Whether the source is watched for new versions.
    pub fn has_releases(&self) -> bool {
        matches!(self.origin, Origin::Releases(_))
    }

    /// Loads the map into memory.
    ///
    /// # Errors
    /// Whatever keeps it from being read.
    pub async fn load(&self) -> anyhow::Result<ServedMap> {
        let MapSource { name, origin } = self.clone();
        let loading = tokio::task::spawn_blocking(move || {
            let map: anyhow::Result<LoadedMap> = match origin {
                Origin::Database(database) => LoadedMap::read(database).map_err(Into::into),
                Origin::Releases(releases) => releases.load(),
            };
            map.inspect(LoadedMap::measure_aliasing_rates)
        });
        let map = loading.await?.with_context(|| format!("map {name} cannot be served"))?;
        let AliasingRate { views, aliased, .. } = map.aliasing_rate();
        let kinds: Vec<String> = map.feature_kinds().into_iter().map(|kind| kind.extractor).collect();
        tracing::info!(
            name,
            aliasing = %format_args!("{aliased:.1} of {views:.1} views look like another place"),
            version = map.info().version,
            identity = %map.identity(),
            keyframes = map.keyframe_count(),
            features = kinds.join(" and "),
            landmarks = map.landmark_count(),
            "loaded a map"
        );
        if map.keyframe_count() == 0 {
            tracing::warn!(name, "the map has no keyframes: no query will match");
        }
        Ok(ServedMap { name, map: Arc::new(map) })
    }

    /// The map, if its version or its identity differs from the served one.
    fn newer(&self, present: &LoadedMap) -> anyhow::Result<Option<LoadedMap>> {
        let (served, identity) = (present.info().version, present.identity());
        let map = match &self.origin {
            Origin::Releases(releases) => releases.newer(served, identity)?,
            Origin::Database(database) => {
                let (stored, landmarks) = store::open_map(database)?;
                let info = &stored.contents.info;
                let is_served = (info.version, info.identity) == (served, Some(identity));
                if is_served { None } else { Some(LoadedMap::load(stored, landmarks)?) }
            }
        };
        let Some(map) = map else { return Ok(None) };
        map.keep_aliasing_rate(present);
        map.measure_aliasing_rates();
        ensure!(map.keyframe_count() > 0, "the new version has no keyframes");
        Ok(Some(map))
    }
}

/// Serves the new versions of the maps that have one. Logs the result of each.
pub async fn reload(server: &MapServer, sources: impl Iterator<Item = &MapSource>) {
    for source in sources {
        let name = &source.name;
        let Some(present) = server.served(name) else { continue };
        let served = present.info().version;
        let reading = {
            let source = source.clone();
            in_background(move || source.newer(&present))
        };
        let read = reading.await.unwrap_or_else(|error| Err(error.into()));
        let replaced = match read {
            Ok(Some(map)) => server.replace(name, Arc::new(map), None).await,
            Ok(None) => {
                if source.has_releases() {
                    tracing::debug!(name, version = served, "the newest release is served");
                } else {
                    tracing::info!(name, version = served, "the database has the version that is served");
                }
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
            Err(error @ (ServeError::OtherMap { .. } | ServeError::OldVersion { .. })) => {
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
