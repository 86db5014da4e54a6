//! A map cut into cells, and put together again.
//!
//! Everything is in exactly one cell: a keyframe in that of its position, a landmark in that of its anchor, a cross-covariance in
//! that of its first keyframe. So nothing is sent twice, and nothing is lost.

use crate::partition::{CellId, Partition};
use map::{Keyframe, KeyframeCrossCovariance, Landmark, MapContents, MapMetadata};
use protocol::KeyframeId;
use std::collections::BTreeMap;

/// What a map has in one cell.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct CellContents {
    pub(crate) keyframes: Vec<Keyframe>,
    pub(crate) landmarks: Vec<Landmark>,
    pub(crate) cross_covariances: Vec<KeyframeCrossCovariance>,
}

/// The same, by reference.
#[derive(Clone, Debug, Default)]
pub(crate) struct CellView<'a> {
    pub(crate) keyframes: Vec<&'a Keyframe>,
    pub(crate) landmarks: Vec<&'a Landmark>,
    pub(crate) cross_covariances: Vec<&'a KeyframeCrossCovariance>,
}

/// Cuts a valid, sorted map into cells, those without a keyframe left out.
pub(crate) fn split<'a>(contents: &'a MapContents, partition: &Partition) -> BTreeMap<CellId, CellView<'a>> {
    let mut cells: BTreeMap<CellId, CellView<'a>> = BTreeMap::new();
    let mut cell_of_keyframe: BTreeMap<KeyframeId, CellId> = BTreeMap::new();
    for keyframe in &contents.keyframes {
        let cell = partition.cell_of(&keyframe.global_from_keyframe.pose.translation);
        cell_of_keyframe.insert(keyframe.id, cell);
        cells.entry(cell).or_default().keyframes.push(keyframe);
    }
    for landmark in &contents.landmarks {
        if let Some(cell) = cell_of_keyframe.get(&landmark.anchor).and_then(|cell| cells.get_mut(cell)) {
            cell.landmarks.push(landmark);
        }
    }
    for cross in &contents.cross_covariances {
        if let Some(cell) = cell_of_keyframe.get(&cross.a).and_then(|cell| cells.get_mut(cell)) {
            cell.cross_covariances.push(cross);
        }
    }
    cells
}

/// Puts a map together.
pub(crate) fn join(info: MapMetadata, cells: impl IntoIterator<Item = CellContents>) -> MapContents {
    let mut contents = MapContents::empty(info);
    for cell in cells {
        contents.keyframes.extend(cell.keyframes);
        contents.landmarks.extend(cell.landmarks);
        contents.cross_covariances.extend(cell.cross_covariances);
    }
    contents.sort();
    contents
}
