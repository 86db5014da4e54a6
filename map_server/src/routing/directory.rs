//! Which cells of a map an image could be of.

use std::collections::BTreeMap;

use map::MapMetadata;
use map::store::STORE_SCHEMA;
use nalgebra::Vector3;
use protocol::{
    DescriptorFormat, Extent, FeatureKind, FeatureSet, KeyframeId, MapIdentity, MapInfoReply, MatchOutcome,
    MatchStatus, PosePrior,
};
use recognition::{CoarseIndex, CoarseIndexBuilder, QueryError, RankedPart, prior_radius};
use releases::{CellId, CoarseCell, Release};
use vision::DescriptorError;

/// A cell is likely where it has at least this part of the votes of the most likely one, or of its keyframes near a prior.
const LIKELY: f64 = 0.5;
/// So many cells are asked first, at most.
const FIRST_CELLS: usize = 3;
/// So many cells are asked in all, at most.
const MOST_CELLS: usize = 8;

/// What every server knows of all cells of a map.
pub struct CellDirectory {
    info: MapMetadata,
    identity: MapIdentity,
    cells: BTreeMap<CellId, DirectedCell>,
    coarse: CoarseIndex,
}

/// Where the place of an image is looked for.
#[derive(Clone, Debug)]
pub struct CellSearch {
    /// The cells that are asked first.
    pub first: Vec<CellId>,
    /// All cells near the prior.
    near: Vec<CellId>,
    /// All cells by the image's features, where all were compared with them.
    ranked: Option<Vec<RankedPart>>,
}

/// The cells near a prior.
#[derive(Default)]
struct Near {
    /// Those with the most keyframes around first.
    cells: Vec<CellId>,
    /// Their keyframes around, by their numbers in the cell.
    keyframes: BTreeMap<CellId, Vec<u32>>,
    /// So many of them have not much fewer keyframes around than the first.
    main: usize,
    /// Whether the camera can't be farther from the prior than it sees.
    is_tight: bool,
}

struct DirectedCell {
    extent: [Vector3<f64>; 2],
    viewing_distance: f64,
    /// Ascending.
    keyframes: Vec<KeyframeId>,
    /// In G, metres.
    positions: Vec<[f32; 3]>,
    landmarks: usize,
    observations: usize,
    cross_covariances: usize,
}

impl CellDirectory {
    /// The directory of a release.
    ///
    /// # Errors
    /// [`DescriptorError`] for landmarks that cannot be indexed.
    pub fn new(
        release: &Release,
        coarse: BTreeMap<CellId, CoarseCell>,
    ) -> Result<CellDirectory, DescriptorError> {
        let info = release.map.clone();
        let mut builder = CoarseIndexBuilder::new(info.clone());
        let mut cells = BTreeMap::new();
        for (cell, CoarseCell { keyframes, positions, landmarks }) in coarse {
            let Some(released) = release.cell(cell) else { continue };
            let serving = &released.serving;
            let looks = landmarks
                .iter()
                .map(|landmark| (landmark.descriptor.as_slice(), landmark.observers.as_slice()));
            builder.add(cell, keyframes.len(), looks)?;
            let directed = DirectedCell {
                extent: released.extent.map(Vector3::from),
                viewing_distance: serving.viewing_distance,
                keyframes,
                positions,
                landmarks: released.landmarks,
                observations: serving.observations,
                cross_covariances: serving.cross_covariances,
            };
            cells.insert(cell, directed);
        }
        Ok(CellDirectory { info, identity: release.identity(), cells, coarse: builder.build()? })
    }

    /// What applies to the map as a whole.
    pub fn info(&self) -> &MapMetadata {
        &self.info
    }

    /// Version of the map.
    pub fn version(&self) -> u64 {
        self.info.version
    }

    /// Identity of the map.
    pub fn identity(&self) -> MapIdentity {
        self.identity
    }

    /// All cells.
    pub fn cells(&self) -> impl Iterator<Item = CellId> {
        self.cells.keys().copied()
    }

    /// Ids of all keyframes with their cells.
    pub fn keyframes(&self) -> impl Iterator<Item = (CellId, KeyframeId)> {
        self.cells.iter().flat_map(|(cell, directed)| directed.keyframes.iter().map(|id| (*cell, *id)))
    }

    /// The cell of a keyframe.
    pub fn cell_of(&self, id: KeyframeId) -> Option<CellId> {
        let has_it = |directed: &DirectedCell| directed.keyframes.binary_search(&id).is_ok();
        self.cells.iter().find(|(_, directed)| has_it(directed)).map(|(cell, _)| *cell)
    }

    /// Number of keyframes of all cells.
    pub fn keyframe_count(&self) -> usize {
        self.cells.values().map(|cell| cell.keyframes.len()).sum()
    }

    /// The cells that are asked first: the one that has most of the keyframes near a tight prior, else the most likely of each place that
    /// the image could show. Near a cut the border of one cell has most of the landmarks that the other could add.
    ///
    /// # Errors
    /// [`QueryError`] where the features cannot be compared with the map.
    pub fn search(&self, features: &FeatureSet, prior: Option<&PosePrior>) -> Result<CellSearch, QueryError> {
        let Near { cells: near, keyframes, main, is_tight } = self.near(prior);
        if near.len() == 1 || (is_tight && main == 1) {
            return Ok(CellSearch { first: near[..1].to_vec(), near, ranked: None });
        }
        if is_tight {
            let ranked = self.coarse.rank_near(features, &keyframes)?;
            let first = self.first_cells(&ranked, &near);
            return Ok(CellSearch { first, near, ranked: None });
        }
        let ranked = self.coarse.rank(features)?;
        let first = self.first_cells(&ranked, &near);
        Ok(CellSearch { first, near, ranked: Some(ranked) })
    }

    /// The most likely cell of each place that an image could show.
    ///
    /// # Arguments
    /// * `near`: only these, if there are any.
    fn first_cells(&self, ranked: &[RankedPart], near: &[CellId]) -> Vec<CellId> {
        let eligible = || ranked.iter().filter(|ranked| near.is_empty() || near.contains(&ranked.part));
        let least = eligible().next().map_or(0.0, |first| LIKELY * first.weight);
        let mut places: Vec<&RankedPart> = Vec::new();
        for likely in eligible().take_while(|ranked| ranked.weight >= least) {
            if places.len() < FIRST_CELLS && !places.iter().any(|place| self.show_one_place(place, likely)) {
                places.push(likely);
            }
        }
        let mut first: Vec<CellId> = places.iter().map(|place| place.part).collect();
        if first.is_empty() {
            // An image that shares nothing with the map still gets the answer of a search.
            first.extend(near.first().copied().or_else(|| self.cells().next()));
        }
        first
    }

    /// The cells that are asked when none of the first ones shows the place: the others near the prior, then the most likely.
    ///
    /// # Errors
    /// [`QueryError`] where the features cannot be compared with the map.
    pub fn then(&self, features: &FeatureSet, search: CellSearch) -> Result<Vec<CellId>, QueryError> {
        let CellSearch { first, near: mut then, ranked } = search;
        let ranked = ranked.map_or_else(|| self.coarse.rank(features), Ok)?;
        for RankedPart { part, .. } in ranked {
            if !then.contains(&part) {
                then.push(part);
            }
        }
        then.retain(|cell| !first.contains(cell));
        then.truncate(MOST_CELLS.saturating_sub(first.len()));
        Ok(then)
    }

    /// Whether the strongest keyframes of two cells are no farther from each other than a camera sees there.
    fn show_one_place(&self, one: &RankedPart, other: &RankedPart) -> bool {
        let of = |ranked: &RankedPart| {
            let directed = self.cells.get(&ranked.part)?;
            let position = directed.positions.get(ranked.keyframe as usize)?;
            Some((Vector3::from(*position).cast::<f64>(), directed.viewing_distance))
        };
        of(one).zip(of(other)).is_some_and(|((one, reach), (other, _))| (one - other).norm() <= reach)
    }

    /// The end of an answer to a match query.
    pub(crate) fn status(&self, outcome: MatchOutcome) -> MatchStatus {
        MatchStatus {
            map_version: self.info.version,
            map_identity: self.identity,
            outcome,
            keyframes_sent: 0,
            searched_keyframes: 0,
            elapsed_us: 0,
            gravity_in_global: self.info.gravity_in_global.map(Into::into),
            sigma_map_px: self.info.sigma_px,
            log_odds: 0.0,
            log_prior_odds: 0.0,
        }
    }

    /// The cells with keyframes that could share a landmark with a camera near a prior pose, those with most of them first.
    fn near(&self, prior: Option<&PosePrior>) -> Near {
        let Some(prior) = prior.map(|prior| &prior.global_from_camera) else {
            return Near::default();
        };
        let (position, radius) = (prior.pose.translation, prior_radius(prior));
        let mut near: Vec<(usize, CellId)> = Vec::new();
        let mut keyframes = BTreeMap::new();
        let mut is_tight = true;
        for (cell, directed) in &self.cells {
            let reach = radius + directed.viewing_distance;
            let [low, high] = &directed.extent;
            if (position.sup(low).inf(high) - position).norm() > reach {
                continue;
            }
            let is_near = |other: &[f32; 3]| (Vector3::from(*other).cast() - position).norm() <= reach;
            let around = (0..).zip(&directed.positions).filter(|(_, other)| is_near(other));
            let around: Vec<u32> = around.map(|(at, _)| at).collect();
            if !around.is_empty() {
                is_tight &= radius <= directed.viewing_distance;
                near.push((around.len(), *cell));
                keyframes.insert(*cell, around);
            }
        }
        near.sort_by_key(|(count, cell)| (std::cmp::Reverse(*count), *cell));
        let most = near.first().map_or(0, |(count, _)| *count);
        let main = near.iter().filter(|(count, _)| *count as f64 >= LIKELY * most as f64).count();
        let cells: Vec<CellId> = near.into_iter().map(|(_, cell)| cell).collect();
        // Far from all keyframes a prior says nothing about the cell.
        is_tight &= !cells.is_empty();
        Near { cells, keyframes, main, is_tight }
    }

    /// Describes the map under the name by which it is served.
    pub fn info_reply(&self, name: &str) -> MapInfoReply {
        let sum = |count: fn(&DirectedCell) -> usize| self.cells.values().map(count).sum::<usize>() as u64;
        let extents = || self.cells.values().map(|cell| &cell.extent);
        let extent = extents().next().map(|[low, high]| Extent {
            min: extents().fold(*low, |least, [low, _]| least.inf(low)).into(),
            max: extents().fold(*high, |most, [_, high]| most.sup(high)).into(),
        });
        let format = DescriptorFormat { kind: self.info.descriptor_kind, width: self.info.descriptor_width };
        MapInfoReply {
            name: name.to_owned(),
            version: self.info.version,
            identity: self.identity,
            database_schema: STORE_SCHEMA,
            keyframes: sum(|cell| cell.keyframes.len()),
            landmarks: sum(|cell| cell.landmarks),
            observations: sum(|cell| cell.observations),
            cross_covariances: sum(|cell| cell.cross_covariances),
            gravity_in_global: self.info.gravity_in_global.map(Into::into),
            extent,
            descriptors: (!self.cells.is_empty()).then_some(format),
            extractor: self.info.extractor.clone(),
            sigma_map_px: self.info.sigma_px,
            // Releases have the primary kind only.
            feature_kinds: (!self.cells.is_empty())
                .then(|| FeatureKind {
                    extractor: self.info.extractor.clone(),
                    descriptors: format,
                    landmarks: sum(|cell| cell.landmarks),
                    observations: sum(|cell| cell.observations),
                    sigma_map_px: self.info.sigma_px,
                })
                .into_iter()
                .collect(),
        }
    }
}
