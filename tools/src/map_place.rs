//! Maps on the command line: a database, or a release of a store.

use std::path::Path;

use anyhow::Context as _;
use map::{MapContents, store};

/// A map that was read for a command.
pub struct NamedMap {
    /// The map.
    pub contents: MapContents,
    /// Bytes of its files, or of the segments of a release.
    pub bytes: u64,
    /// Which release it is, for a person; `None` for a database.
    pub release: Option<String>,
}

/// Reads the map of a database, or of a release: `city.db`, `s3://bucket/city`, `/srv/city@7`, `/srv/city@candidate`.
///
/// # Errors
/// A map that cannot be read, a store that has no such release.
pub fn read_map(map: &Path) -> anyhow::Result<NamedMap> {
    if is_released(map) {
        return released::read(map).with_context(|| format!("--map {}", map.display()));
    }
    let stored = store::load_map(map)?;
    Ok(NamedMap { contents: stored.contents, bytes: stored.bytes_on_disk, release: None })
}

/// Whether a map is a release: a URL, or a folder that was published to and holds no map besides.
pub fn is_released(map: &Path) -> bool {
    let is_url = map.to_str().is_some_and(|text| text.contains("://"));
    is_url || released::is_folder(map) && !store::is_map(map)
}

#[cfg(feature = "releases")]
mod released {
    use super::NamedMap;
    use crate::command::releases::in_store;
    use anyhow::Context as _;
    use releases::{Release, ReleasePlace, fetch};
    use std::path::Path;

    pub(super) fn is_folder(map: &Path) -> bool {
        map.to_str().is_some_and(|text| ReleasePlace::from(text).is_released())
    }

    pub(super) fn read(map: &Path) -> anyhow::Result<NamedMap> {
        let place = ReleasePlace::from(map.to_str().context("this is no URL")?);
        let (release, contents) = in_store(&place.url, async |store| {
            let release = place.choice.of(&store).await?;
            let contents = fetch(&store, &release, None).await?;
            Ok((release, contents))
        })?;
        Ok(NamedMap { contents, bytes: release.bytes(), release: Some(described(&release)) })
    }

    /// A release with who published it, and why.
    fn described(release: &Release) -> String {
        let by = release.note.author.as_ref().map(|author| format!(" by {author}"));
        let why = release.note.comment.as_ref().map(|comment| format!(": {comment}"));
        format!("{}{}{}", release.title(), by.unwrap_or_default(), why.unwrap_or_default())
    }
}

#[cfg(not(feature = "releases"))]
mod released {
    use super::NamedMap;
    use std::path::Path;

    pub(super) fn is_folder(_: &Path) -> bool {
        false
    }

    pub(super) fn read(_: &Path) -> anyhow::Result<NamedMap> {
        anyhow::bail!("this program was built without the feature `releases`, which reads maps from there")
    }
}
