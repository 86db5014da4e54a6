//! Publishing a map, and going back to a former release.

use crate::cells::{CellView, split};
use crate::error::ReleaseError;
use crate::partition::{CellId, Partition};
use crate::release::{RELEASE_SCHEMA, Release, ReleasedCell, ReleasedMap, SegmentName};
use crate::segment::encode;
use crate::store::ReleaseStore;
use map::{Keyframe, MapContents};
use std::collections::BTreeSet;
use std::time::{SystemTime, UNIX_EPOCH};

/// Keyframes in a cell at most, by default: some 200 MB of a map of images.
const KEYFRAMES_A_CELL: usize = 5000;

/// How a map is published.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct PublishOptions {
    /// Cells with more keyframes than these are cut.
    pub keyframes_a_cell: usize,
}

impl Default for PublishOptions {
    fn default() -> Self {
        Self { keyframes_a_cell: KEYFRAMES_A_CELL }
    }
}

/// How far publishing or fetching has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress {
    /// Cells that are done.
    pub cells: usize,
    /// All cells.
    pub of: usize,
}

/// What became of a map.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// It is a release now.
    Published(Box<Published>),
    /// The newest release has the same map.
    Unchanged {
        /// Its number.
        number: u64,
    },
}

/// A release that was just put.
#[derive(Clone, Debug, PartialEq)]
pub struct Published {
    /// The release.
    pub release: Release,
    /// Segments that the store did not have.
    pub sent: usize,
    /// Their bytes.
    pub bytes_sent: u64,
}

/// Publishes a map as the next release.
///
/// The identity of the first release is that of the map, and stays. Versions grow from release to release.
///
/// # Errors
/// [`ReleaseError::Contents`] for a map that violates an invariant, [`ReleaseError::OtherMap`] where the store has another map,
/// [`ReleaseError::Conflict`] where another program was faster, [`ReleaseError::Store`].
pub async fn publish(
    store: &ReleaseStore,
    mut contents: MapContents,
    options: &PublishOptions,
    mut progress: impl FnMut(Progress),
) -> Result<Outcome, ReleaseError> {
    contents.validate()?;
    contents.sort();
    let former = store.newest().await?;
    let digest = contents.digest();
    let identity = contents.info.identity.unwrap_or(digest);
    if let Some(former) = &former {
        if former.map.identity != identity {
            return Err(ReleaseError::OtherMap {
                place: store.place().to_owned(),
                given: identity,
                published: former.map.identity,
            });
        }
        if former.map.digest == digest {
            return Ok(Outcome::Unchanged { number: former.number });
        }
    }
    let mut partition = former
        .as_ref()
        .map_or_else(|| Partition::whole(contents.info.gravity_in_global), |former| former.partition.clone());
    let position = |keyframe: &Keyframe| keyframe.global_from_keyframe.pose.translation;
    let positions: Vec<_> = contents.keyframes.iter().map(position).collect();
    partition.cut(&positions, options.keyframes_a_cell);

    // Those that the newest release names are there and stay there.
    let present: BTreeSet<SegmentName> =
        former.iter().flat_map(|former| &former.cells).map(|cell| cell.segment.clone()).collect();
    let views = split(&contents, &partition);
    let (of, mut sent, mut bytes_sent) = (views.len(), 0, 0);
    let mut cells = Vec::with_capacity(of);
    for (done, (cell, view)) in views.iter().enumerate() {
        progress(Progress { cells: done, of });
        let bytes = encode(view)?;
        let segment = SegmentName::of(&bytes);
        if !present.contains(&segment) {
            (sent, bytes_sent) = (sent + 1, bytes_sent + segment.bytes);
            store.put_segment(&segment, bytes).await?;
        }
        cells.push(released_cell(*cell, view, segment));
    }
    progress(Progress { cells: of, of });
    let former_version = former.as_ref().map_or(0, |former| former.map.version);
    let version = contents.info.version.max(former_version + 1);
    let release = Release {
        schema: RELEASE_SCHEMA,
        number: former.as_ref().map_or(0, |former| former.number) + 1,
        published_unix_s: now_unix_s(),
        rolled_back_to: None,
        map: ReleasedMap::new(&contents.info, version, identity, digest),
        partition,
        cells,
    };
    store.put_release(&release).await?;
    Ok(Outcome::Published(Box::new(Published { release, sent, bytes_sent })))
}

/// Publishes the map of a former release again, as the newest one.
///
/// # Errors
/// [`ReleaseError::NoRelease`], [`ReleaseError::Conflict`], [`ReleaseError::Store`].
pub async fn roll_back(store: &ReleaseStore, number: u64) -> Result<Outcome, ReleaseError> {
    let former = store.release(number).await?;
    let newest = store.newest().await?.unwrap_or_else(|| former.clone());
    if newest.map.digest == former.map.digest {
        return Ok(Outcome::Unchanged { number: newest.number });
    }
    let release = Release {
        number: newest.number + 1,
        published_unix_s: now_unix_s(),
        rolled_back_to: Some(number),
        map: ReleasedMap { version: newest.map.version + 1, ..former.map.clone() },
        ..former
    };
    store.put_release(&release).await?;
    Ok(Outcome::Published(Box::new(Published { release, sent: 0, bytes_sent: 0 })))
}

fn released_cell(cell: CellId, view: &CellView<'_>, segment: SegmentName) -> ReleasedCell {
    let positions = || view.keyframes.iter().map(|keyframe| keyframe.global_from_keyframe.pose.translation);
    let bound = |start: f64, better: fn(f64, f64) -> f64| {
        std::array::from_fn(|axis| positions().map(|position| position[axis]).fold(start, better))
    };
    ReleasedCell {
        cell,
        keyframes: view.keyframes.len(),
        landmarks: view.landmarks.len(),
        extent: [bound(f64::INFINITY, f64::min), bound(f64::NEG_INFINITY, f64::max)],
        segment,
    }
}

/// A clock before 1970 gives 0.
pub(crate) fn now_unix_s() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs())
}
