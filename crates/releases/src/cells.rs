//! A map cut into cells, and put together again.
//!
//! Everything is in exactly one cell: a keyframe in that of its position with its common error, its aliases and its image, a landmark of
//! any kind in that of its anchor with what is known of its existence, a cross-covariance in that of its first keyframe. So nothing is
//! sent twice, and nothing is lost.
//!
//! Beside it a cell has a *border*, what an answer of this cell needs of others: the landmarks that its keyframes observe, the
//! keyframes that observe one of these, and the cross-covariances of its own keyframes and of those of the border with all
//! others, and their common errors. So a cell answers for its keyframes with everything that the whole map has: no correlation is cut.
//! Features of added kinds have no border: a cell by itself is served with the primary kind.

use crate::partition::{CellId, Partition};
use map::difference::Compared;
use map::file::{Segment, SegmentWriter};
use map::{
    AddedFeatures, CommonError, FeatureKind, KeptImage, Keyframe, KeyframeAliases, KeyframeCrossCovariance,
    Landmark, LandmarkExistence, MapContents, MapMetadata, RecordError,
};
use protocol::{KeyframeId, LandmarkId};
use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};

/// What a map has in one cell, or in the border of one.
#[derive(Clone, Debug, Default)]
pub(crate) struct CellView<'a> {
    /// Those of a border without their features.
    pub(crate) keyframes: Vec<Cow<'a, Keyframe>>,
    pub(crate) landmarks: Vec<&'a Landmark>,
    pub(crate) cross_covariances: Vec<&'a KeyframeCrossCovariance>,
    pub(crate) common_errors: Vec<&'a CommonError>,
    pub(crate) aliases: Vec<&'a KeyframeAliases>,
    pub(crate) existence: Vec<&'a LandmarkExistence>,
}

impl<'a> CellView<'a> {
    /// Adds it to what is compared of a version.
    pub(crate) fn add_to(&'a self, compared: &mut Compared<'a>) {
        self.keyframes.iter().for_each(|keyframe| compared.add_keyframe(keyframe));
        self.landmarks.iter().for_each(|landmark| compared.add_landmark(landmark));
        self.cross_covariances.iter().for_each(|cross| compared.add_cross_covariance(cross));
        self.common_errors.iter().for_each(|common| compared.add_common_error(common));
    }

    /// The segment of it.
    pub(crate) fn encode(&self) -> Result<Vec<u8>, RecordError> {
        let mut segment = SegmentWriter::default();
        self.keyframes.iter().try_for_each(|keyframe| segment.add(keyframe.as_ref()).map(drop))?;
        self.landmarks.iter().try_for_each(|landmark| segment.add(*landmark).map(drop))?;
        self.cross_covariances.iter().try_for_each(|cross| segment.add(*cross).map(drop))?;
        self.common_errors.iter().try_for_each(|common| segment.add(*common).map(drop))?;
        self.aliases.iter().try_for_each(|aliases| segment.add(*aliases).map(drop))?;
        self.existence.iter().try_for_each(|existence| segment.add(*existence).map(drop))?;
        Ok(segment.finish())
    }
}

/// A cell and its border.
#[derive(Clone, Debug, Default)]
pub(crate) struct BorderedCell<'a> {
    pub(crate) own: CellView<'a>,
    pub(crate) border: CellView<'a>,
    /// Its landmarks of the added kinds of features, by kind.
    pub(crate) added: Vec<Vec<&'a Landmark>>,
    /// Images of its keyframes.
    pub(crate) images: Vec<&'a KeptImage>,
}

impl BorderedCell<'_> {
    /// The segments of the added kinds of features, one each.
    pub(crate) fn encode_added(&self) -> Result<Vec<Vec<u8>>, RecordError> {
        let encode = |landmarks: &Vec<&Landmark>| {
            let mut segment = SegmentWriter::default();
            landmarks.iter().try_for_each(|landmark| segment.add(*landmark).map(drop))?;
            Ok(segment.finish())
        };
        self.added.iter().map(encode).collect()
    }

    /// The segment of its images; `None` where it has none.
    pub(crate) fn encode_images(&self) -> Result<Option<Vec<u8>>, RecordError> {
        if self.images.is_empty() {
            return Ok(None);
        }
        let mut segment = SegmentWriter::of_images();
        self.images.iter().try_for_each(|image| segment.add(*image).map(drop))?;
        Ok(Some(segment.finish()))
    }
}

/// A cell as it is put together again, without its border.
pub(crate) struct JoinedCell {
    pub(crate) segment: Segment,
    /// As [`BorderedCell::added`].
    pub(crate) added: Vec<Vec<Landmark>>,
    pub(crate) images: Vec<KeptImage>,
}

/// Cuts a valid, sorted map into cells, those without a keyframe left out.
pub(crate) fn split<'a>(
    contents: &'a MapContents,
    partition: &Partition,
) -> BTreeMap<CellId, BorderedCell<'a>> {
    let mut cells: BTreeMap<CellId, BorderedCell<'a>> = BTreeMap::new();
    let mut cell_of: BTreeMap<KeyframeId, CellId> = BTreeMap::new();
    for keyframe in &contents.keyframes {
        let cell = partition.cell_of(&keyframe.global_from_keyframe.pose.translation);
        cell_of.insert(keyframe.id, cell);
        cells.entry(cell).or_default().own.keyframes.push(Cow::Borrowed(keyframe));
    }
    for part in cells.values_mut() {
        part.added = vec![Vec::new(); contents.added_features.len()];
    }
    for (kind, added) in contents.added_features.iter().enumerate() {
        for landmark in &added.landmarks {
            if let Some(part) = cell_of.get(&landmark.anchor).and_then(|cell| cells.get_mut(cell)) {
                part.added[kind].push(landmark);
            }
        }
    }
    for image in &contents.images {
        if let Some(part) = cell_of.get(&image.keyframe).and_then(|cell| cells.get_mut(cell)) {
            part.images.push(image);
        }
    }
    let borders = add_landmarks(contents, &cell_of, &mut cells);
    for keyframe in &contents.keyframes {
        for cell in borders.get(&keyframe.id).into_iter().flatten() {
            let bordered = cells.entry(*cell).or_default();
            bordered.border.keyframes.push(Cow::Owned(without_features(keyframe)));
        }
    }
    for common in &contents.common_errors {
        if let Some(cell) = cell_of.get(&common.keyframe).and_then(|cell| cells.get_mut(cell)) {
            cell.own.common_errors.push(common);
        }
        for cell in borders.get(&common.keyframe).into_iter().flatten() {
            cells.entry(*cell).or_default().border.common_errors.push(common);
        }
    }
    for aliases in &contents.aliases {
        if let Some(cell) = cell_of.get(&aliases.keyframe).and_then(|cell| cells.get_mut(cell)) {
            cell.own.aliases.push(aliases);
        }
    }
    for cross in &contents.cross_covariances {
        let own = cell_of.get(&cross.a);
        if let Some(cell) = own.and_then(|cell| cells.get_mut(cell)) {
            cell.own.cross_covariances.push(cross);
        }
        let ends = [cross.a, cross.b];
        let of_borders = ends.iter().filter_map(|end| borders.get(end)).flatten();
        let all: BTreeSet<&CellId> = cell_of.get(&cross.b).into_iter().chain(of_borders).collect();
        for cell in all.into_iter().filter(|cell| Some(*cell) != own) {
            cells.entry(*cell).or_default().border.cross_covariances.push(cross);
        }
    }
    cells
}

/// Adds each landmark to the cell of its anchor, and to the borders of the other cells that observe it.
///
/// # Returns
/// The cells to whose borders a keyframe belongs.
fn add_landmarks<'a>(
    contents: &'a MapContents,
    cell_of: &BTreeMap<KeyframeId, CellId>,
    cells: &mut BTreeMap<CellId, BorderedCell<'a>>,
) -> BTreeMap<KeyframeId, BTreeSet<CellId>> {
    let mut borders: BTreeMap<KeyframeId, BTreeSet<CellId>> = BTreeMap::new();
    let existence: BTreeMap<LandmarkId, &LandmarkExistence> =
        contents.existence.iter().map(|existence| (existence.landmark, existence)).collect();
    for landmark in &contents.landmarks {
        let Some(home) = cell_of.get(&landmark.anchor) else { continue };
        if let Some(of_landmark) = existence.get(&landmark.id) {
            cells.entry(*home).or_default().own.existence.push(of_landmark);
        }
        let observers = || landmark.observations.iter().map(|observation| observation.keyframe);
        let observing: BTreeSet<CellId> = observers().filter_map(|id| cell_of.get(&id).copied()).collect();
        for cell in &observing {
            let bordered = cells.entry(*cell).or_default();
            let part = if cell == home { &mut bordered.own } else { &mut bordered.border };
            part.landmarks.push(landmark);
            if observing.len() > 1 {
                for observer in observers().filter(|id| cell_of.get(id) != Some(cell)) {
                    borders.entry(observer).or_default().insert(*cell);
                }
            }
        }
    }
    borders
}

/// A robot needs none of them, and those of the whole image are the larger part of a keyframe.
fn without_features(keyframe: &Keyframe) -> Keyframe {
    Keyframe {
        id: keyframe.id,
        stamp_ns: keyframe.stamp_ns,
        global_from_keyframe: keyframe.global_from_keyframe,
        camera: keyframe.camera.clone(),
        features: None,
    }
}

/// Puts a map together.
///
/// # Arguments
/// * `added_kinds`: of the landmarks of each cell, in their order.
pub(crate) fn join(
    info: MapMetadata,
    added_kinds: &[FeatureKind],
    cells: impl IntoIterator<Item = JoinedCell>,
) -> MapContents {
    let mut contents = MapContents::empty(info);
    let of_kind = |kind: &FeatureKind| AddedFeatures { kind: kind.clone(), landmarks: Vec::new() };
    contents.added_features = added_kinds.iter().map(of_kind).collect();
    for JoinedCell { segment: cell, added, images } in cells {
        for (of_kind, landmarks) in contents.added_features.iter_mut().zip(added) {
            of_kind.landmarks.extend(landmarks);
        }
        contents.images.extend(images);
        contents.keyframes.extend(cell.keyframes);
        contents.landmarks.extend(cell.landmarks);
        contents.cross_covariances.extend(cell.cross_covariances);
        contents.common_errors.extend(cell.common_errors);
        contents.aliases.extend(cell.aliases);
        contents.existence.extend(cell.existence);
    }
    contents.sort();
    contents
}
