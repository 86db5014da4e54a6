//! The map of a release, or some of its cells.

use crate::cache::ReleaseCache;
use crate::cells::{JoinedCell, join};
use crate::coarse::CoarseCell;
use crate::damage::Damage;
use crate::error::ReleaseError;
use crate::partition::CellId;
use crate::release::{Release, ReleasedCell};
use crate::store::ReleaseStore;
use bytes::Bytes;
use map::file::{Segment, SegmentError, SegmentName, decode_images};
use map::{KeyframeAliases, KeyframeCrossCovariance, MapContents, MapMetadata};
use protocol::KeyframeId;
use std::collections::{BTreeMap, BTreeSet};

/// Fetches the map of a release; its info has the release's version and the identity of all releases.
///
/// # Arguments
/// * `cache`: segments that it has are not fetched, and those that it has not are added to it. A cache that cannot be written
///   is logged and not used.
///
/// # Errors
/// [`ReleaseError::Store`], [`ReleaseError::Damaged`], [`ReleaseError::Segment`].
pub async fn fetch(
    store: &ReleaseStore,
    release: &Release,
    cache: Option<&ReleaseCache>,
) -> Result<MapContents, ReleaseError> {
    let contents = joined(store, release, cache, true).await?;
    let digest = contents.digest();
    if digest != release.digest {
        let damage = Damage::Digest { found: digest, stated: release.digest };
        return Err(store.damaged(release.title(), damage));
    }
    Ok(contents)
}

/// As [`fetch`](fn@fetch), without the images of keyframes: a server has no use for them. The digest of a map is that of all of it; of one with
/// images every segment is checked by itself.
///
/// # Errors
/// As [`fetch`](fn@fetch).
pub async fn fetch_without_images(
    store: &ReleaseStore,
    release: &Release,
    cache: Option<&ReleaseCache>,
) -> Result<MapContents, ReleaseError> {
    if release.cells.iter().all(|cell| cell.images.is_none()) {
        return fetch(store, release, cache).await;
    }
    let contents = joined(store, release, cache, false).await?;
    contents.validate()?;
    Ok(contents)
}

async fn joined(
    store: &ReleaseStore,
    release: &Release,
    cache: Option<&ReleaseCache>,
    with_images: bool,
) -> Result<MapContents, ReleaseError> {
    let mut cells = Vec::with_capacity(release.cells.len());
    for cell in &release.cells {
        cells.push(whole_cell(store, cell, cache, with_images).await?);
    }
    Ok(join(release.map.clone(), &release.added_kinds, cells))
}

/// What the whole map has in a cell.
async fn whole_cell(
    store: &ReleaseStore,
    cell: &ReleasedCell,
    cache: Option<&ReleaseCache>,
    with_images: bool,
) -> Result<JoinedCell, ReleaseError> {
    let mut added = Vec::with_capacity(cell.added_features.len());
    for name in &cell.added_features {
        added.push(cell_contents(store, name, cache).await?.landmarks);
    }
    let images = match cell.images.as_ref().filter(|_| with_images) {
        Some(name) => {
            let bytes = segment(store, name, cache).await?;
            decode_images(&bytes).map_err(|source| unreadable(store, name, source))?
        }
        None => Vec::new(),
    };
    Ok(JoinedCell { segment: cell_contents(store, &cell.segment, cache).await?, added, images })
}

/// A cell that can be served without the others, with features of the primary kind.
#[derive(Clone, Debug, PartialEq)]
pub struct Cell {
    /// The cell's keyframes, ascending.
    pub own: Vec<KeyframeId>,
    /// Its keyframes and those of its border, with the landmarks that its own keyframes observe, and the sessions of these keyframes.
    pub contents: MapContents,
    /// Cross-covariances of these keyframes with those of other cells.
    pub far_cross_covariances: Vec<KeyframeCrossCovariance>,
    /// What the cell's keyframes could be taken for, in this and in other cells.
    pub aliases: Vec<KeyframeAliases>,
}

/// Fetches one cell of a release with its border.
///
/// # Arguments
/// * `cache`: as in [`fetch`](fn@fetch).
///
/// # Errors
/// [`ReleaseError::NoCell`], and as [`fetch`](fn@fetch).
pub async fn fetch_cell(
    store: &ReleaseStore,
    release: &Release,
    cell: CellId,
    cache: Option<&ReleaseCache>,
) -> Result<Cell, ReleaseError> {
    let released = release.cell(cell).ok_or_else(|| ReleaseError::NoCell {
        place: store.place().to_owned(),
        release: release.title(),
        cell,
    })?;
    let serving = &released.serving;
    let inside = cell_contents(store, &released.segment, cache).await?;
    let border = cell_contents(store, &serving.border, cache).await?;
    let own = inside.keyframes.iter().map(|keyframe| keyframe.id).collect();
    // A server has many cells in memory, and the ledger of a city is long.
    let info = MapMetadata { sessions: Vec::new(), ..release.map.clone() };
    let parts = [inside, border].map(|segment| JoinedCell { segment, added: vec![], images: vec![] });
    let mut contents = join(info, &[], parts);
    contents.take_sessions_of(&release.map);
    let known: BTreeSet<KeyframeId> = contents.keyframes.iter().map(|keyframe| keyframe.id).collect();
    let is_near = |cross: &KeyframeCrossCovariance| known.contains(&cross.a) && known.contains(&cross.b);
    let (near, far_cross_covariances) = contents.cross_covariances.into_iter().partition(is_near);
    contents.cross_covariances = near;
    let aliases = std::mem::take(&mut contents.aliases);
    // Of use to who changes the map as a whole only.
    contents.existence = Vec::new();
    contents.validate()?;
    Ok(Cell { own, contents, far_cross_covariances, aliases })
}

/// Fetches what tells from afar of which cells an image could be: of all cells of a release.
///
/// # Errors
/// As [`fetch_cell`].
pub async fn fetch_coarse(
    store: &ReleaseStore,
    release: &Release,
    cache: Option<&ReleaseCache>,
) -> Result<BTreeMap<CellId, CoarseCell>, ReleaseError> {
    let mut cells = BTreeMap::new();
    for released in &release.cells {
        let named = &released.serving.coarse;
        let bytes = segment(store, named, cache).await?;
        let width = usize::from(release.map.descriptor_width);
        let coarse = CoarseCell::decode(&bytes, width).map_err(|source| unreadable(store, named, source))?;
        cells.insert(released.cell, coarse);
    }
    Ok(cells)
}

fn unreadable(store: &ReleaseStore, segment: &SegmentName, source: SegmentError) -> ReleaseError {
    ReleaseError::Segment { place: store.place().to_owned(), segment: segment.sha256.clone(), source }
}

/// What a segment holds.
pub(crate) async fn cell_contents(
    store: &ReleaseStore,
    name: &SegmentName,
    cache: Option<&ReleaseCache>,
) -> Result<Segment, ReleaseError> {
    let bytes = segment(store, name, cache).await?;
    Segment::decode(&bytes).map_err(|source| unreadable(store, name, source))
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
