//! The databases and releases of the served maps: loaded when the server starts, and again on request.
//!
//! Another program can write the next version of a map meanwhile. If the new version cannot be loaded, the previous one continues
//! to be served.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, bail};
use map::MapMetadata;
use map::store::{self, StoredLandmarks, StoredMap};
use map_server::map_argument::MapArgument;
use map_server::state::MapVersion;
use map_server::{MapServer, ServedMap, ServerState};
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
    /// # Arguments
    /// * `state`: says what robots were served before, which decides about the number of the version.
    ///
    /// # Errors
    /// Whatever keeps it from being read.
    pub async fn load(&self, state: Option<&Arc<ServerState>>) -> anyhow::Result<ServedMap> {
        let MapSource { name, origin } = self.clone();
        let state = state.cloned();
        let loading = tokio::task::spawn_blocking(move || {
            let before = state.and_then(|state| last_served(&state, &name));
            let map: anyhow::Result<LoadedMap> = match origin {
                Origin::Database(database) => Stored::open(&database).and_then(|stored| {
                    let number = number_after(&name, &stored.version(), before.as_ref());
                    stored.load(number)
                }),
                Origin::Releases(releases) => releases.newest_or_cached().and_then(|release| {
                    let number = number_after(&name, &version_of(&release), before.as_ref());
                    let map = releases.load(&release, number)?;
                    releases.keep(&release);
                    Ok(map)
                }),
            };
            map.inspect(LoadedMap::measure_aliasing_rates)
        });
        let name = self.name.clone();
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

    /// The map, if its version, its contents or its identity differ from those of the served one.
    fn newer(&self, present: &LoadedMap) -> anyhow::Result<Option<NewVersion>> {
        let served = MapVersion::of(present);
        let is_served =
            |new: &MapVersion, number: u64| (new.identity, number) == (served.identity, served.version);
        let new = match &self.origin {
            Origin::Releases(releases) => {
                let Some(release) = releases.newest()? else { return Ok(None) };
                let new = version_of(&release);
                if is_served(&new, new.number_after(&served)) || releases.is_refused(&release) {
                    return Ok(None);
                }
                let number = number_after(&self.name, &new, Some(&served));
                let map = Arc::new(releases.load(&release, number)?);
                NewVersion { map, release: Some(release) }
            }
            Origin::Database(database) => {
                let stored = Stored::open(database)?;
                let new = stored.version();
                if is_served(&new, new.number_after(&served)) {
                    return Ok(None);
                }
                let number = number_after(&self.name, &new, Some(&served));
                NewVersion { map: Arc::new(stored.load(number)?), release: None }
            }
        };
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

    /// Notes that a version is served from now on.
    async fn keep(&self, new: &NewVersion) {
        let (Origin::Releases(releases), Some(release)) = (self.origin.clone(), new.release.clone()) else {
            return;
        };
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
        let replacement = match server.prepare_replacement(name, Arc::clone(&new.map), None).await {
            Ok(replacement) => replacement,
            Err(error) => {
                tracing::warn!(
                    name,
                    version,
                    "reload refused; the previous version continues to be served: {error}"
                );
                return self.refuse(new);
            }
        };
        // Before it answers: a server that is killed serves it again, also where the store is away.
        self.keep(&new).await;
        if let Err(error) = replacement.serve().await {
            tracing::warn!(name, "the new version is served, but its notice was not published: {error:#}");
        }
    }
}

/// A map that is stored, before its landmarks are read.
struct Stored {
    map: StoredMap,
    landmarks: StoredLandmarks,
}

impl Stored {
    fn open(database: &Path) -> anyhow::Result<Stored> {
        let (map, landmarks) = store::open_map(database)?;
        Ok(Stored { map, landmarks })
    }

    fn version(&self) -> MapVersion {
        let MapMetadata { version, identity, .. } = self.map.contents.info;
        // A stored map has one.
        let (digest, identity) = (self.map.digest, identity.unwrap_or(self.map.digest));
        MapVersion { identity, version, digest: Some(digest) }
    }

    /// Loads it under a number.
    fn load(mut self, number: u64) -> anyhow::Result<LoadedMap> {
        self.map.contents.info.version = number;
        Ok(LoadedMap::load(self.map, self.landmarks)?)
    }
}

fn version_of(release: &Release) -> MapVersion {
    MapVersion { identity: release.identity(), version: release.map.version, digest: Some(release.digest) }
}

/// What robots were served last; `None` where that is not known. A state that fails is logged.
fn last_served(state: &ServerState, name: &str) -> Option<MapVersion> {
    let served = state.last_served(name);
    let served =
        served.inspect_err(|error| tracing::warn!(name, "what was served before is not known: {error}"));
    served.ok()?.map(|served| served.map_version())
}

/// The number under which a version is served; says where that is not its own.
fn number_after(name: &str, new: &MapVersion, served: Option<&MapVersion>) -> u64 {
    let Some(served) = served else { return new.version };
    let number = new.number_after(served);
    if number != new.version && new.digest == served.digest {
        tracing::info!(
            name,
            version = new.version,
            served_as = number,
            "the map is what was served before, and is served under the number that it had then"
        );
    } else if number != new.version {
        tracing::warn!(
            name,
            version = new.version,
            served_as = number,
            "the map has the number of the version that was served, and other contents: it was changed in two places, or a copy was put in \
             its place. It is served under the next number, so that robots do not take one for the other"
        );
    }
    number
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
