//! Keyframes that are not in use: their loadings wait as they were, and are brought up to date when they are needed.
//!
//! Those parked together are a *layer*; layers are ordered by the time at which they were parked. Between two of them lies
//! one matrix, all that happened to the rows of the state from the one time to the other; behind the newest lies the
//! running one, the only one that a step of the filter touches (`Moving`):
//! ```text
//! layer 0 --S0--> layer 1 --S1--> ... --S(k-1)--> layer k --R--> now        M now = R S(k-1) ... S(i) M of layer i
//! ```
//! A layer that is at most twice as large as the next one moves into it, a few keyframes a step, each multiplied by the
//! matrix between; emptied, it leaves the product of the two matrices beside it. So there are logarithmically many layers,
//! each keyframe moves logarithmically often, and no single step has to move many.

use super::super::dense::Dense;
use super::HeldKeyframe;
use super::moving::{KEYFRAME_DIM, Moving};
use super::packed::Packed;
use faer::linalg::matmul::triangular::BlockStructure;
use nalgebra::Matrix6;
use protocol::KeyframeId;
use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

/// A layer moves into the next one while it is at most this many times as large.
const LAYER_RATIO: usize = 2;
/// Keyframes that move at once: enough columns for a product to be fast.
const MOVED_AT_ONCE: usize = 12;

#[derive(Clone, Debug)]
struct ParkedKeyframe {
    keyframe: HeldKeyframe,
    /// Shared by the copies of a filter, which try a step and are thrown away.
    loadings: Arc<Packed>,
}

#[derive(Clone, Debug)]
struct Layer {
    /// Grows from layer to layer, in their order.
    serial: u64,
    members: Vec<ParkedKeyframe>,
    /// From here to the next layer. Not used in the newest.
    onward: Arc<Dense>,
}

/// All parked keyframes.
#[derive(Clone, Debug, Default)]
pub struct Parked {
    layers: Vec<Layer>,
    /// Serial of its layer and place in it.
    places: HashMap<KeyframeId, (u64, usize)>,
    by_last_use: BTreeMap<u64, KeyframeId>,
    next_serial: u64,
}

impl Parked {
    /// How many.
    pub fn len(&self) -> usize {
        self.places.len()
    }

    /// All names.
    pub fn ids(&self) -> impl Iterator<Item = KeyframeId> + '_ {
        self.layers.iter().flat_map(|layer| layer.members.iter().map(|member| member.keyframe.id))
    }

    /// A parked keyframe.
    pub fn get(&self, id: KeyframeId) -> Option<&HeldKeyframe> {
        let (layer, place) = self.place_of(id)?;
        Some(&self.layers[layer].members[place].keyframe)
    }

    /// Names of the `count` that were used longest ago.
    pub fn least_recently_used(&self, count: usize) -> Vec<KeyframeId> {
        self.by_last_use.values().take(count).copied().collect()
    }

    /// Parks keyframes, as a layer of their own.
    ///
    /// # Arguments
    /// * `members`: with their loadings, columns one after the other.
    /// * `moving`: begins to run anew.
    pub fn add(&mut self, members: Vec<(HeldKeyframe, Vec<f64>)>, moving: &mut Moving) {
        let frozen = moving.freeze();
        if let Some(newest) = self.layers.last_mut() {
            newest.onward = Arc::new(frozen);
        }
        let serial = self.next_serial;
        self.next_serial += 1;
        self.layers.push(Layer {
            serial,
            members: Vec::with_capacity(members.len()),
            onward: Arc::default(),
        });
        let newest = self.layers.len() - 1;
        for (keyframe, loadings) in members {
            self.by_last_use.insert(keyframe.last_used, keyframe.id);
            self.put(newest, keyframe, &loadings, moving.nrows());
        }
    }

    /// Takes keyframes out.
    ///
    /// # Arguments
    /// * `ids`: their names; those that are not parked are passed over.
    ///
    /// # Returns
    /// The keyframes, and their loadings as they are now: six columns each, in the same order.
    pub fn take(&mut self, ids: &[KeyframeId], moving: &mut Moving) -> (Vec<HeldKeyframe>, Dense) {
        let mut found: Vec<(usize, KeyframeId)> =
            ids.iter().filter_map(|id| Some((self.place_of(*id)?.0, *id))).collect();
        found.sort_unstable();
        found.dedup();
        let Some(&(first, _)) = found.first() else { return (Vec::new(), Dense::zeros(moving.nrows(), 0)) };
        let mut taken = Vec::with_capacity(found.len());
        let mut loadings = Dense::default();
        let mut rest = found.as_slice();
        for layer in first..self.layers.len() {
            let here = rest.iter().take_while(|(of, _)| *of == layer).count();
            for (_, id) in &rest[..here] {
                let Some(member) = self.remove(*id) else { continue };
                if loadings.ncols() == 0 {
                    loadings.reset(member.loadings.nrows(), 0);
                }
                loadings.extend_columns(member.loadings.numbers());
                taken.push(member.keyframe);
            }
            rest = &rest[here..];
            loadings = self.onward(layer, &loadings, moving);
        }
        self.remove_empty_layers(moving);
        (taken, loadings)
    }

    /// `sum of M_k B_k` over those of `terms` that are parked, as it is now; `None` where none is.
    pub fn weighted_sum<'a>(
        &self,
        terms: impl Iterator<Item = (KeyframeId, &'a Matrix6<f64>)>,
        moving: &Moving,
    ) -> Option<Dense> {
        let mut found: Vec<(usize, usize, &Matrix6<f64>)> = terms
            .filter_map(|(id, block)| self.place_of(id).map(|(layer, place)| (layer, place, block)))
            .collect();
        found.sort_unstable_by_key(|(layer, place, _)| (*layer, *place));
        let first = found.first()?.0;
        let mut rest = found.as_slice();
        let mut sum = Dense::default();
        for layer in first..self.layers.len() {
            let here = rest.iter().take_while(|(of, ..)| *of == layer).count();
            for (_, place, block) in &rest[..here] {
                let loadings = unpacked(&self.layers[layer].members[*place].loadings);
                if sum.ncols() == 0 {
                    sum.reset(loadings.nrows(), KEYFRAME_DIM);
                }
                let block = Dense::from_columns(KEYFRAME_DIM, block.as_slice());
                let all = 0..KEYFRAME_DIM;
                sum.add_product(&loadings, all.clone(), &block, all, BlockStructure::Rectangular);
            }
            rest = &rest[here..];
            sum = self.onward(layer, &sum, moving);
        }
        Some(sum)
    }

    /// Moves at most about `most` keyframes into larger layers, where there are layers too many.
    pub fn tidy(&mut self, most: usize, moving: &mut Moving) {
        let mut moved = 0;
        while moved < most {
            let crowded = (1..self.layers.len()).rev().find(|&newer| {
                self.layers[newer - 1].members.len() <= LAYER_RATIO * self.layers[newer].members.len()
            });
            let Some(newer) = crowded else { return };
            moved += self.move_some(newer - 1);
            self.remove_empty_layers(moving);
        }
    }

    /// Moves some keyframes of a layer into the next one.
    fn move_some(&mut self, layer: usize) -> usize {
        let source = &self.layers[layer];
        let ids: Vec<KeyframeId> =
            source.members.iter().rev().take(MOVED_AT_ONCE).map(|member| member.keyframe.id).collect();
        let onward = Arc::clone(&source.onward);
        let mut loadings = Dense::zeros(onward.ncols(), 0);
        let mut moved = Vec::with_capacity(ids.len());
        for id in ids {
            let last_use = self.get(id).map(|keyframe| keyframe.last_used);
            let Some(member) = self.remove(id) else { continue };
            self.by_last_use.extend(last_use.map(|use_number| (use_number, id)));
            loadings.extend_columns(member.loadings.numbers());
            moved.push(member.keyframe);
        }
        let loadings = product(&onward, &loadings);
        let width = KEYFRAME_DIM * onward.nrows();
        let count = moved.len();
        for (keyframe, own) in moved.into_iter().zip(loadings.as_slice().chunks_exact(width)) {
            self.put(layer + 1, keyframe, own, onward.nrows());
        }
        count
    }

    /// A layer without members leaves the product of the matrices before and behind it.
    fn remove_empty_layers(&mut self, moving: &mut Moving) {
        while let Some(empty) = self.layers.iter().position(|layer| layer.members.is_empty()) {
            let newest = empty + 1 == self.layers.len();
            let removed = self.layers.remove(empty);
            match empty.checked_sub(1).map(|before| &mut self.layers[before]) {
                None if newest => moving.stop(),
                None => {}
                Some(before) if newest => moving.lengthen(&std::mem::take::<Arc<Dense>>(&mut before.onward)),
                Some(before) => before.onward = Arc::new(product(&removed.onward, &before.onward)),
            }
        }
    }

    /// From the time of a layer to that of the next one, or to now.
    fn onward(&self, layer: usize, loadings: &Dense, moving: &Moving) -> Dense {
        if layer + 1 == self.layers.len() {
            moving.times_running(loadings)
        } else {
            product(&self.layers[layer].onward, loadings)
        }
    }

    fn put(&mut self, layer: usize, keyframe: HeldKeyframe, loadings: &[f64], rows: usize) {
        let target = &mut self.layers[layer];
        self.places.insert(keyframe.id, (target.serial, target.members.len()));
        target.members.push(ParkedKeyframe { keyframe, loadings: Arc::new(Packed::new(loadings, rows)) });
    }

    fn remove(&mut self, id: KeyframeId) -> Option<ParkedKeyframe> {
        let (layer, place) = self.place_of(id)?;
        self.places.remove(&id);
        let members = &mut self.layers[layer].members;
        let removed = members.swap_remove(place);
        if let Some(moved) = members.get(place) {
            self.places.insert(moved.keyframe.id, (self.layers[layer].serial, place));
        }
        self.by_last_use.remove(&removed.keyframe.last_used);
        Some(removed)
    }

    /// Its layer and its place there.
    fn place_of(&self, id: KeyframeId) -> Option<(usize, usize)> {
        let &(serial, place) = self.places.get(&id)?;
        let layer = self.layers.binary_search_by_key(&serial, |layer| layer.serial).ok()?;
        Some((layer, place))
    }

    /// How many layers there are.
    pub fn layers(&self) -> usize {
        self.layers.len()
    }

    /// Bytes on the heap: loadings, names, and the matrices between the layers.
    pub fn heap_bytes(&self) -> usize {
        /// Bookkeeping of a map's entry: a control byte, or a node's share.
        const ENTRY: usize = 8;
        /// Two counters.
        const ARC: usize = 16;
        let layers: usize = self
            .layers
            .iter()
            .map(|layer| {
                let loadings =
                    |member: &ParkedKeyframe| ARC + size_of::<Packed>() + member.loadings.heap_bytes();
                layer.members.iter().map(loadings).sum::<usize>()
                    + layer.members.capacity() * size_of::<ParkedKeyframe>()
                    + layer.onward.heap_bytes()
            })
            .sum();
        layers
            + self.places.capacity() * (size_of::<(KeyframeId, (u64, usize))>() + ENTRY)
            + self.by_last_use.len() * (size_of::<(u64, KeyframeId)>() + ENTRY)
    }
}

fn product(left: &Dense, right: &Dense) -> Dense {
    let mut product = Dense::zeros(left.nrows(), right.ncols());
    product.add_product(left, 0..left.ncols(), right, 0..right.nrows(), BlockStructure::Rectangular);
    product
}

fn unpacked(loadings: &Packed) -> Dense {
    let mut dense = Dense::zeros(loadings.nrows(), 0);
    dense.extend_columns(loadings.numbers());
    dense
}
