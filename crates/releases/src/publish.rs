//! Publishing a map, and going back to a former release.

use crate::candidates::next_version;
use crate::cells::{CellView, split};
use crate::change::{change_back, change_since};
use crate::cleaning::ensure_kept;
use crate::coarse::CoarseCell;
use crate::error::ReleaseError;
use crate::partition::Partition;
use crate::release::{RELEASE_SCHEMA, Release, ReleasedCell, ServedCell};
use crate::stage::{Note, Stage};
use crate::store::ReleaseStore;
use map::file::SegmentName;
use map::sessions::SessionDifference;
use map::{Keyframe, MapContents, MapMetadata};
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
    /// Live, or proposed to be.
    pub stage: Stage,
    /// Who publishes, and why.
    pub note: Note,
    /// Whether sessions that the newest release has and the map lacks may be lost with it: the map was built anew.
    pub may_lose_sessions: bool,
}

impl Default for PublishOptions {
    fn default() -> Self {
        Self {
            keyframes_a_cell: KEYFRAMES_A_CELL,
            stage: Stage::Live,
            note: Note::default(),
            may_lose_sessions: false,
        }
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

/// Publishes a map as the next release, or as a candidate for it.
///
/// The identity of the first release is that of the map, and stays. Versions grow from release to release. Features of added kinds and
/// the images of keyframes are in segments of their own, which a server of single cells does not fetch.
///
/// # Errors
/// [`ReleaseError::Contents`] for a map that violates an invariant, [`ReleaseError::OtherMap`] where the store has another map,
/// [`ReleaseError::LosesSessions`] where the newest release has sessions that the map lacks and these may not be lost,
/// [`ReleaseError::Conflict`] and [`ReleaseError::CandidateConflict`] where another program was faster, [`ReleaseError::Cleaning`] where one removes segments,
/// [`ReleaseError::TooLong`], [`ReleaseError::LongLedger`], [`ReleaseError::Store`].
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
        if former.identity() != identity {
            return Err(ReleaseError::OtherMap {
                place: store.place().to_owned(),
                given: identity,
                published: former.identity(),
            });
        }
        if former.digest == digest {
            return Ok(Outcome::Unchanged { number: former.number });
        }
        if !options.may_lose_sessions {
            ensure_keeps_sessions(store, former, &contents)?;
        }
    }
    let mut partition = former
        .as_ref()
        .map_or_else(|| Partition::whole(contents.info.gravity_in_global), |former| former.partition.clone());
    let position = |keyframe: &Keyframe| keyframe.global_from_keyframe.pose.translation;
    let positions: Vec<_> = contents.keyframes.iter().map(position).collect();
    partition.cut(&positions, options.keyframes_a_cell);

    // Those that the newest release names are there and stay there.
    let mut sending = Sending { store, present: BTreeSet::new(), sent: 0, bytes_sent: 0 };
    sending.present.extend(former.iter().flat_map(Release::segments).cloned());
    let parts = split(&contents, &partition);
    let of = parts.len();
    let mut cells = Vec::with_capacity(of);
    for (done, (&cell, part)) in parts.iter().enumerate() {
        progress(Progress { cells: done, of });
        let segment = sending.put(part.own.encode()?).await?;
        let mut added_features = Vec::with_capacity(part.added.len());
        for bytes in part.encode_added()? {
            added_features.push(sending.put(bytes).await?);
        }
        let images = match part.encode_images()? {
            Some(bytes) => Some(sending.put(bytes).await?),
            None => None,
        };
        let serving = ServedCell {
            border: sending.put(part.border.encode()?).await?,
            coarse: sending.put(CoarseCell::of(part).encode()?).await?,
            observations: part.own.landmarks.iter().map(|landmark| landmark.observations.len()).sum(),
            cross_covariances: part.own.cross_covariances.len(),
            viewing_distance: viewing_distance(&part.own),
        };
        cells.push(ReleasedCell {
            cell,
            keyframes: part.own.keyframes.len(),
            landmarks: part.own.landmarks.len(),
            extent: extent(&part.own),
            segment,
            added_features,
            images,
            serving,
        });
    }
    let change = match &former {
        Some(former) => Some(change_since(store, former, &cells, &parts).await),
        None => None,
    };
    let Sending { sent, bytes_sent, .. } = sending;
    progress(Progress { cells: of, of });
    let version = contents.info.version.max(next_version(store, former.as_ref()).await?);
    let candidate = match options.stage {
        Stage::Live => None,
        Stage::Candidate => Some(store.candidate_numbers().await?.last().map_or(1, |last| last + 1)),
    };
    let sessions = contents.sessions_to_store();
    let mut release = Release {
        schema: RELEASE_SCHEMA,
        stage: options.stage,
        candidate,
        note: options.note.clone(),
        promotion: None,
        number: former.as_ref().map_or(0, |former| former.number) + 1,
        published_unix_s: now_unix_s(),
        rolled_back_to: None,
        change,
        map: MapMetadata { version, identity: Some(identity), sessions, ..contents.info.clone() },
        added_kinds: contents.added_features.iter().map(|added| added.kind.clone()).collect(),
        digest,
        partition,
        cells,
    };
    release.schema = release.schema_needed();
    let release = store.fitted(release)?;
    ensure_kept(store, &release).await?;
    match candidate {
        Some(number) => store.put_candidate(&release, number).await?,
        None => store.put_release(&release).await?,
    }
    Ok(Outcome::Published(Box::new(Published { release, sent, bytes_sent })))
}

/// Refuses a map that lacks sessions of the newest release.
fn ensure_keeps_sessions(
    store: &ReleaseStore,
    newest: &Release,
    contents: &MapContents,
) -> Result<(), ReleaseError> {
    let lost = SessionDifference::between(&newest.map.sessions, &contents.info.sessions).removed;
    let Some(first) = lost.first() else { return Ok(()) };
    Err(ReleaseError::LosesSessions {
        place: store.place().to_owned(),
        number: newest.number,
        sessions: lost.len(),
        first: first.name.clone(),
    })
}

/// Publishes the map of a former release again, as the newest one.
///
/// Its segments are put again: [`clean`](crate::clean()) removes what only former releases name, and spares what was put just now.
///
/// # Errors
/// [`ReleaseError::NoRelease`], [`ReleaseError::SourceNotSigned`] where the store signs and the former release is not
/// signed with its key, [`ReleaseError::Conflict`], [`ReleaseError::Store`], [`ReleaseError::Cleaning`], [`ReleaseError::TooLong`], [`ReleaseError::LongLedger`].
pub async fn roll_back(store: &ReleaseStore, number: u64, note: &Note) -> Result<Outcome, ReleaseError> {
    let former = store.release_to_sign(number).await?;
    let newest = store.newest().await?.unwrap_or_else(|| former.clone());
    if newest.digest == former.digest {
        return Ok(Outcome::Unchanged { number: newest.number });
    }
    let change = change_back(store, &newest, &former).await;
    let version = next_version(store, Some(&newest)).await?;
    let release = Release {
        schema: former.schema_needed(),
        number: newest.number + 1,
        candidate: None,
        published_unix_s: now_unix_s(),
        note: note.clone(),
        promotion: None,
        rolled_back_to: Some(number),
        change: Some(change),
        map: MapMetadata { version, ..former.map.clone() },
        ..former
    };
    let release = store.fitted(release)?;
    renew(store, Some(&newest), &release).await?;
    ensure_kept(store, &release).await?;
    store.put_release(&release).await?;
    Ok(Outcome::Published(Box::new(Published { release, sent: 0, bytes_sent: 0 })))
}

/// Puts the segments of a release again that the newest one does not name.
pub(crate) async fn renew(
    store: &ReleaseStore,
    newest: Option<&Release>,
    release: &Release,
) -> Result<(), ReleaseError> {
    let kept: BTreeSet<&SegmentName> = newest.into_iter().flat_map(Release::segments).collect();
    let renewed: BTreeSet<&SegmentName> =
        release.segments().filter(|segment| !kept.contains(segment)).collect();
    for segment in renewed {
        let bytes = store.segment(segment).await?;
        store.put_segment(segment, bytes.into()).await?;
    }
    Ok(())
}

/// Segments on their way into a store.
struct Sending<'a> {
    store: &'a ReleaseStore,
    /// What is there.
    present: BTreeSet<SegmentName>,
    sent: usize,
    bytes_sent: u64,
}

impl Sending<'_> {
    /// Puts a segment, unless it is there.
    async fn put(&mut self, bytes: Vec<u8>) -> Result<SegmentName, ReleaseError> {
        let segment = SegmentName::of(&bytes);
        if self.present.insert(segment.clone()) {
            self.store.put_segment(&segment, bytes).await?;
            (self.sent, self.bytes_sent) = (self.sent + 1, self.bytes_sent + segment.bytes);
        }
        Ok(segment)
    }
}

/// Median distance between keyframes and the landmarks that are anchored in them.
fn viewing_distance(cell: &CellView<'_>) -> f64 {
    let mut distances: Vec<f64> =
        cell.landmarks.iter().map(|landmark| landmark.position_in_anchor.norm()).collect();
    geometry::median(&mut distances).unwrap_or(0.0)
}

/// Smallest and largest coordinates of the keyframes in G, metres.
fn extent(cell: &CellView<'_>) -> [[f64; 3]; 2] {
    let positions = || cell.keyframes.iter().map(|keyframe| keyframe.global_from_keyframe.pose.translation);
    let bound = |start: f64, better: fn(f64, f64) -> f64| {
        std::array::from_fn(|axis| positions().map(|position| position[axis]).fold(start, better))
    };
    [bound(f64::INFINITY, f64::min), bound(f64::NEG_INFINITY, f64::max)]
}

/// A clock before 1970 gives 0.
pub(crate) fn now_unix_s() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs())
}
