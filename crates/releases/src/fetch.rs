//! The map of a release.

use crate::cache::ReleaseCache;
use crate::cells::join;
use crate::error::ReleaseError;
use crate::release::{Release, SegmentName};
use crate::segment::decode;
use crate::store::ReleaseStore;
use bytes::Bytes;
use map::MapContents;

/// Fetches the map of a release; its info has the release's version and the identity of all releases.
///
/// # Arguments
/// * `cache`: segments that it has are not fetched, and those that it has not are added to it. A cache that cannot be written
///   is logged and gone without.
///
/// # Errors
/// [`ReleaseError::Store`], [`ReleaseError::Damaged`], [`ReleaseError::Segment`].
pub async fn fetch(
    store: &ReleaseStore,
    release: &Release,
    cache: Option<&ReleaseCache>,
) -> Result<MapContents, ReleaseError> {
    let mut cells = Vec::with_capacity(release.cells.len());
    for cell in &release.cells {
        let bytes = segment(store, &cell.segment, cache).await?;
        let contents = decode(&bytes).map_err(|source| ReleaseError::Segment {
            place: store.place().to_owned(),
            segment: cell.segment.sha256.clone(),
            source,
        })?;
        cells.push(contents);
    }
    let contents = join(release.map.metadata(), cells);
    let digest = contents.digest();
    if digest != release.map.digest {
        let reason = format!("its cells give the digest {digest}, it states {}", release.map.digest);
        return Err(store.damaged(format!("release {}", release.number), reason));
    }
    Ok(contents)
}

async fn segment(
    store: &ReleaseStore,
    name: &SegmentName,
    cache: Option<&ReleaseCache>,
) -> Result<Bytes, ReleaseError> {
    if let Some(bytes) = cache.and_then(|cache| cache.segment(name)) {
        return Ok(bytes);
    }
    let bytes = store.segment(name).await?;
    if let Some(Err(error)) = cache.map(|cache| cache.keep_segment(name, &bytes)) {
        tracing::warn!("a segment is not kept: {}", crate::error::with_causes(&error));
    }
    Ok(bytes)
}
