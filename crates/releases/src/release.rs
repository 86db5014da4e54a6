//! What a release is.

use crate::change::ReleasedChange;
use crate::damage::Damage;
use crate::partition::{CellId, Partition};
use crate::stage::{Note, Stage};
use map::file::SegmentName;
use map::sessions::SessionDifference;
use map::{FeatureKind, MapMetadata};
use protocol::MapIdentity;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Layout of releases of a map that has features of one kind and no images.
pub const RELEASE_SCHEMA: u16 = 9;
/// Layout of releases of a map with added features or images, the newest one.
pub const EXTENDED_RELEASE_SCHEMA: u16 = 10;
/// The oldest layout that is read: it has no `keyframe_motions`.
pub const OLDEST_RELEASE_SCHEMA: u16 = 8;

/// One state of a map, as it is in the store. Never changes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Release {
    /// Layout of this file, see [`RELEASE_SCHEMA`] and [`EXTENDED_RELEASE_SCHEMA`].
    pub schema: u16,
    /// Where it stands. A file that lies elsewhere is refused.
    pub stage: Stage,
    /// Counts the live releases, from 1. Of a candidate, the number that it would have.
    pub number: u64,
    /// Number among the candidates, from 1: of a candidate, and of a live release that was one.
    pub candidate: Option<u64>,
    /// When it was published, seconds since 1970; of one that was promoted, when it was.
    pub published_unix_s: u64,
    /// Who published it, and why.
    pub note: Note,
    /// Of a release that was a candidate: who promoted it, and why.
    pub promotion: Option<Note>,
    /// The release whose map this one has again; `None` for a map of its own.
    pub rolled_back_to: Option<u64>,
    /// What changed since the release before; `None` for the first one.
    pub change: Option<ReleasedChange>,
    /// What applies to the map as a whole: its version grows from release to release, its identity is the same in all.
    pub map: MapMetadata,
    /// The kinds of features that were added to the map.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub added_kinds: Vec<FeatureKind>,
    /// Of the map's contents; equal where they are.
    pub digest: MapIdentity,
    /// Which place belongs to which cell.
    pub partition: Partition,
    /// Cells with keyframes, by their numbers.
    pub cells: Vec<ReleasedCell>,
}

/// One cell of a release.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReleasedCell {
    /// Its number in the partition.
    pub cell: CellId,
    /// How many keyframes it has.
    pub keyframes: usize,
    /// How many landmarks are anchored in them.
    pub landmarks: usize,
    /// Smallest and largest coordinates of its keyframes in G, metres.
    pub extent: [[f64; 3]; 2],
    /// Where its contents are.
    pub segment: SegmentName,
    /// Where its landmarks of the added kinds are, one segment for each kind of the release.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub added_features: Vec<SegmentName>,
    /// Where the images of its keyframes are, if any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub images: Option<SegmentName>,
    /// What it needs to be served by itself.
    pub serving: ServedCell,
}

/// What a cell needs to be served without the others.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ServedCell {
    /// What other cells have and an answer of this cell needs.
    pub border: SegmentName,
    /// What tells from afar whether an image could be of this cell.
    pub coarse: SegmentName,
    /// Observations of the landmarks that are anchored in its keyframes.
    pub observations: usize,
    /// Cross-covariances that are stored with its keyframes.
    pub cross_covariances: usize,
    /// Median distance between its keyframes and the landmarks that they observe, metres.
    pub viewing_distance: f64,
}

/// What one release has and another one has not.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ReleaseDifference {
    /// Cells of the second only.
    pub added: Vec<CellId>,
    /// Cells of the first only.
    pub removed: Vec<CellId>,
    /// Cells of both with different contents.
    pub changed: Vec<CellId>,
    /// Cells of both with the same contents.
    pub unchanged: usize,
    /// Bytes of the cells' own segments that a copy of the first lacks for the second.
    pub bytes: u64,
    /// Sessions that the maps were made of.
    pub sessions: SessionDifference,
}

impl ReleasedCell {
    /// All that the whole map has of it.
    fn own(&self) -> impl Iterator<Item = &SegmentName> {
        std::iter::once(&self.segment).chain(&self.added_features).chain(&self.images)
    }

    /// Its own segments, and those for serving it by itself.
    pub(crate) fn segments(&self) -> impl Iterator<Item = &SegmentName> {
        self.own().chain([&self.serving.border, &self.serving.coarse])
    }
}

impl Release {
    /// The identity of the map: what is published states one, and that of a new map is its digest.
    pub fn identity(&self) -> MapIdentity {
        self.map.identity.unwrap_or(self.digest)
    }

    /// The layout that the release has: programs that know only the first one read releases that need nothing else.
    pub(crate) fn schema_needed(&self) -> u16 {
        let has_images = self.cells.iter().any(|cell| cell.images.is_some());
        if self.added_kinds.is_empty() && !has_images { RELEASE_SCHEMA } else { EXTENDED_RELEASE_SCHEMA }
    }

    /// Everything that the release names.
    pub(crate) fn segments(&self) -> impl Iterator<Item = &SegmentName> {
        self.cells.iter().flat_map(ReleasedCell::segments)
    }

    /// A cell by its number.
    pub fn cell(&self, cell: CellId) -> Option<&ReleasedCell> {
        self.cells.binary_search_by_key(&cell, |released| released.cell).ok().map(|at| &self.cells[at])
    }

    /// Keyframes of all cells.
    pub fn keyframes(&self) -> usize {
        self.cells.iter().map(|cell| cell.keyframes).sum()
    }

    /// Landmarks of all cells.
    pub fn landmarks(&self) -> usize {
        self.cells.iter().map(|cell| cell.landmarks).sum()
    }

    /// Bytes of the cells' own segments, which is what a copy of the whole map is fetched from. Borders and coarse landmarks, which
    /// serve a cell by itself, come on top.
    pub fn bytes(&self) -> u64 {
        let own = self.cells.iter().flat_map(ReleasedCell::own);
        own.map(|segment| segment.bytes).fold(0, u64::saturating_add)
    }

    /// What `later` has and this release has not.
    pub fn difference(&self, later: &Self) -> ReleaseDifference {
        fn by_cell(release: &Release) -> BTreeMap<CellId, Vec<&SegmentName>> {
            release.cells.iter().map(|cell| (cell.cell, cell.own().collect())).collect()
        }
        let (before, after) = (by_cell(self), by_cell(later));
        let present: BTreeSet<&SegmentName> = before.values().flatten().copied().collect();
        let sessions = SessionDifference::between(&self.map.sessions, &later.map.sessions);
        let mut difference = ReleaseDifference { sessions, ..ReleaseDifference::default() };
        for (cell, segments) in &after {
            match before.get(cell) {
                Some(former) if former == segments => difference.unchanged += 1,
                Some(_) => difference.changed.push(*cell),
                None => difference.added.push(*cell),
            }
            for segment in segments.iter().filter(|segment| !present.contains(*segment)) {
                difference.bytes = difference.bytes.saturating_add(segment.bytes);
            }
        }
        difference.removed = before.into_keys().filter(|cell| !after.contains_key(cell)).collect();
        difference
    }

    /// Its name for a person: `release 7`, `candidate 3`.
    pub fn title(&self) -> String {
        match (self.stage, self.candidate) {
            (Stage::Candidate, Some(candidate)) => format!("candidate {candidate}"),
            _ => format!("release {}", self.number),
        }
    }

    /// Reads the file of a live release.
    pub(crate) fn decode(text: &[u8], number: u64) -> Result<Self, Damage> {
        let release = Self::decode_any(text)?;
        match release.stage {
            Stage::Live if release.number == number => Ok(release),
            Stage::Live => Err(Damage::Number(release.number)),
            Stage::Candidate => Err(Damage::Stage(release.stage)),
        }
    }

    /// Reads the file of a candidate.
    pub(crate) fn decode_candidate(text: &[u8], number: u64) -> Result<Self, Damage> {
        let release = Self::decode_any(text)?;
        match (release.stage, release.candidate) {
            (Stage::Candidate, Some(candidate)) if candidate == number => Ok(release),
            (Stage::Candidate, candidate) => Err(Damage::CandidateNumber(candidate.unwrap_or(0))),
            (Stage::Live, _) => Err(Damage::Stage(release.stage)),
        }
    }

    /// Reads the file of a release, wherever it lies.
    pub(crate) fn decode_any(text: &[u8]) -> Result<Self, Damage> {
        let value: serde_json::Value = serde_json::from_slice(text)?;
        // Another layout may have other fields.
        let found = value.get("schema").and_then(serde_json::Value::as_u64).unwrap_or(0);
        if !(u64::from(OLDEST_RELEASE_SCHEMA)..=u64::from(EXTENDED_RELEASE_SCHEMA)).contains(&found) {
            return Err(Damage::Schema { found });
        }
        let release: Self = serde_json::from_value(value)?;
        let is_extended = release.schema_needed() == EXTENDED_RELEASE_SCHEMA;
        if is_extended != (release.schema == EXTENDED_RELEASE_SCHEMA) {
            return Err(Damage::Fields { schema: release.schema });
        }
        for note in [Some(&release.note), release.promotion.as_ref()].into_iter().flatten() {
            note.check().map_err(|(what, at_most)| Damage::Note { what, at_most })?;
        }
        release.partition.check()?;
        let mut known = release.partition.cells();
        known.sort_unstable();
        for pair in release.cells.windows(2) {
            if pair[0].cell >= pair[1].cell {
                return Err(Damage::Order(pair[1].cell));
            }
        }
        for released in &release.cells {
            let cell = released.cell;
            if known.binary_search(&cell).is_err() {
                return Err(Damage::NoCell(cell));
            }
            if released.added_features.len() != release.added_kinds.len() {
                let (found, stated) = (released.added_features.len(), release.added_kinds.len());
                return Err(Damage::AddedKinds { cell, found, stated });
            }
            if let Some(segment) = released.segments().find(|segment| !segment.is_valid()) {
                return Err(Damage::SegmentName { cell, name: segment.sha256.clone() });
            }
        }
        Ok(release)
    }
}
