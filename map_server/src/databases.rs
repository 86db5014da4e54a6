//! The databases and releases of the served maps: loaded when the server starts, and again on request.
//!
//! Another program can write the next version of a map meanwhile. If the new version cannot be loaded, the previous one continues
//! to be served.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, bail};
use map::store;
use map_server::map_argument::MapArgument;
use map_server::{MapServer, ServeError, ServedMap};
use recognition::{AliasingRate, LoadedMap};
use releases::{Release, ReleaseKey};

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
                Origin::Releases(releases) => releases.load().map(|(map, release)| {
                    releases.keep(&release);
                    map
                }),
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

    /// Releases that were refused are loaded again.
    pub fn look_again(&self) {
        if let Origin::Releases(releases) = &self.origin {
            releases.look_again();
        }
    }

    /// The map, if its version or its identity differs from the served one.
    fn newer(&self, present: &LoadedMap) -> anyhow::Result<Option<NewVersion>> {
        let (served, identity) = (present.info().version, present.identity());
        let new = match &self.origin {
            Origin::Releases(releases) => releases
                .newer(served, identity)?
                .map(|(map, release)| NewVersion { map: Arc::new(map), release: Some(release) }),
            Origin::Database(database) => {
                let (stored, landmarks) = store::open_map(database)?;
                let info = &stored.contents.info;
                if (info.version, info.identity) == (served, Some(identity)) {
                    return Ok(None);
                }
                let map = Arc::new(LoadedMap::load(stored, landmarks)?);
                Some(NewVersion { map, release: None })
            }
        };
        let Some(new) = new else { return Ok(None) };
        if new.map.keyframe_count() == 0 {
            self.refuse(new);
            bail!("the new version has no keyframes");
        }
        new.map.keep_aliasing_rate(present);
        new.map.measure_aliasing_rates();
        Ok(Some(new))
    }

    fn refuse(&self, new: NewVersion) {
        if let (Origin::Releases(releases), Some(release)) = (&self.origin, new.release) {
            releases.refuse(release);
        }
    }

    /// Notes that a version is served now.
    async fn keep(&self, new: NewVersion) {
        let (Origin::Releases(releases), Some(release)) = (self.origin.clone(), new.release) else { return };
        if let Err(error) = in_background(move || releases.keep(&release)).await {
            tracing::warn!(name = self.name, "the release is not kept: {error}");
        }
    }

    /// Serves the newest version, if that is another one. Logs the result.
    async fn reload(&self, server: &MapServer) {
        let name = &self.name;
        let Some(present) = server.served(name) else { return };
        let version = present.info().version;
        let reading = {
            let source = self.clone();
            in_background(move || source.newer(&present))
        };
        let new = match reading.await.unwrap_or_else(|error| Err(error.into())) {
            Ok(Some(new)) => new,
            Ok(None) if self.has_releases() => {
                return tracing::debug!(name, version, "the newest release is served, or was refused");
            }
            Ok(None) => return tracing::info!(name, version, "the database has the version that is served"),
            Err(reason) => {
                let reason = format!("{reason:#}");
                return tracing::warn!(
                    name,
                    version,
                    reason,
                    "reload failed; the previous version continues to be served"
                );
            }
        };
        let replaced = server.replace(name, Arc::clone(&new.map), None).await;
        if let Err(
            error @ (ServeError::OtherMap { .. }
            | ServeError::OldVersion { .. }
            | ServeError::TaskFailed { .. }),
        ) = replaced
        {
            tracing::warn!(
                name,
                version,
                "reload refused; the previous version continues to be served: {error}"
            );
            return self.refuse(new);
        }
        if let Err(error) = replaced {
            tracing::warn!(name, "the new version is served, but its notice was not published: {error:#}");
        }
        self.keep(new).await;
    }
}

/// A version that is not served yet.
struct NewVersion {
    map: Arc<LoadedMap>,
    /// That it was fetched of.
    release: Option<Release>,
}

/// Serves the new versions of the maps that have one. Logs the result of each.
pub async fn reload(server: &MapServer, sources: impl Iterator<Item = &MapSource>) {
    for source in sources {
        source.reload(server).await;
    }
}
