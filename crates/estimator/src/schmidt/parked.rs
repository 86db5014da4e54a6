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
//!
//! The longer the time between two layers, the fewer directions of the state still matter (`waist`). Where these are few,
//! `S = Q C`, the older layer turns to `Q`, and its members become `C M`, again a few keyframes a step.

use super::HeldKeyframe;
use super::layer::{Layer, Narrowing, ParkedKeyframe, product};
use super::moving::{KEYFRAME_DIM, Moving};
use super::packed::Packed;
use super::waist::waist;
use crate::KeyframeId;
use crate::linear_algebra::dense::Dense;
use faer::linalg::matmul::triangular::BlockStructure;
use nalgebra::Matrix6;
use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

/// A layer moves into the next one while it is at most this many times as large. Larger ratios make fewer layers and more
/// moves.
const LAYER_RATIO: (usize, usize) = (3, 2);
/// Keyframes that move at once: enough columns for a product to be fast.
const MOVED_AT_ONCE: usize = 12;
/// A layer of fewer members is not worth the search for a waist, which takes as long as moving a hundred.
const WORTH_NARROWING: usize = 64;
/// Steps after which a waist is looked for behind the newest layer: the window has turned over.
const STEPS_TO_WAIST: usize = 40;
/// A waist is one if it is at most this part of the rows wide.
const WAIST: (usize, usize) = (3, 4);

/// All parked keyframes.
#[derive(Clone, Debug, Default)]
pub struct Parked {
    layers: Vec<Layer>,
    /// Serial of its layer and place in it.
    places: HashMap<KeyframeId, (u64, usize)>,
    by_last_use: BTreeMap<u64, KeyframeId>,
    next_serial: u64,
    /// Steps since keyframes were last parked.
    steps: usize,
}

/// Keyframes that were taken out of one layer.
pub struct Taken {
    pub keyframes: Vec<HeldKeyframe>,
    /// Six columns each, in the rows of the layer.
    pub loadings: Dense,
    /// From the rows of the layer to those of the state.
    pub to_now: Dense,
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
        self.steps = 0;
        if let Some(newest) = self.layers.last_mut() {
            newest.onward = Arc::new(frozen);
            newest.searched = false;
        }
        let serial = self.next_serial;
        self.next_serial += 1;
        self.layers.push(Layer {
            serial,
            members: Vec::with_capacity(members.len()),
            onward: Arc::default(),
            searched: false,
            narrowing: None,
        });
        let newest = self.layers.len() - 1;
        for (keyframe, loadings) in members {
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
            let members = rest[..here].iter().filter_map(|(_, id)| self.remove(*id)).collect();
            taken.extend(self.layers[layer].columns_of(members, &mut loadings));
            rest = &rest[here..];
            loadings = self.onward(layer, &loadings, moving);
        }
        self.remove_empty_layers(moving);
        (taken, loadings)
    }

    /// Takes keyframes out as [`Self::take`] does, but leaves their loadings in the rows of their layers: for many of them
    /// that is far less to multiply.
    pub fn take_in_layers(&mut self, ids: &[KeyframeId], moving: &mut Moving) -> Vec<Taken> {
        let mut found: Vec<Vec<KeyframeId>> = vec![Vec::new(); self.layers.len()];
        for id in ids {
            if let Some((layer, _)) = self.place_of(*id) {
                found[layer].push(*id);
            }
        }
        let mut taken = Vec::new();
        let mut to_now: Option<Dense> = None;
        for (layer, ids) in found.iter().enumerate().rev() {
            let here = match &to_now {
                None => moving.running(),
                Some(later) => product(later, &self.layers[layer].onward),
            };
            let members: Vec<ParkedKeyframe> = ids.iter().filter_map(|id| self.remove(*id)).collect();
            if !members.is_empty() {
                let mut loadings = Dense::default();
                let keyframes = self.layers[layer].columns_of(members, &mut loadings);
                taken.push(Taken { keyframes, loadings, to_now: here.clone() });
            }
            to_now = Some(here);
        }
        self.remove_empty_layers(moving);
        taken
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
            let source = &self.layers[layer];
            let members = rest[..here].iter().map(|(_, place, _)| source.members[*place].clone()).collect();
            let mut columns = Dense::default();
            let order = source.columns_of(members, &mut columns);
            for (k, keyframe) in order.iter().enumerate() {
                let Some((.., block)) = rest[..here]
                    .iter()
                    .find(|(_, place, _)| source.members[*place].keyframe.id == keyframe.id)
                else {
                    continue;
                };
                if sum.ncols() == 0 {
                    sum.reset(columns.nrows(), KEYFRAME_DIM);
                }
                let block = Dense::from_columns(KEYFRAME_DIM, block.as_slice());
                let own = KEYFRAME_DIM * k..KEYFRAME_DIM * (k + 1);
                sum.add_product(&columns, own, &block, 0..KEYFRAME_DIM, BlockStructure::Rectangular);
            }
            rest = &rest[here..];
            sum = self.onward(layer, &sum, moving);
        }
        Some(sum)
    }

    /// Brings some keyframes nearer to now: moves them into the next layer, where there are layers too many, or to a waist.
    /// To be called in every step; takes about as long as the step itself at most, and the search for a waist a few times
    /// that.
    pub fn compact(&mut self, moving: &mut Moving) {
        self.steps += 1;
        let unsearched = |layer: &Layer| !layer.searched && layer.members.len() >= WORTH_NARROWING;
        let last = self.layers.len().saturating_sub(1);
        let crowded = (0..last).rev().find(|&older| {
            let of = |layer: usize| self.layers[layer].members.len();
            LAYER_RATIO.1 * of(older) <= LAYER_RATIO.0 * of(older + 1)
        });
        if let Some(older) = crowded {
            self.move_some(older);
        } else if let Some(layer) = self.layers.iter().position(|layer| layer.narrowing.is_some()) {
            self.narrow_some(layer);
        } else if let Some(layer) = self.layers[..last].iter().position(unsearched) {
            self.search_waist(layer);
        } else if self.steps == STEPS_TO_WAIST && !self.layers.is_empty() {
            self.search_running_waist(moving);
        }
        self.remove_empty_layers(moving);
    }

    /// Moves some keyframes of a layer into the next one.
    fn move_some(&mut self, layer: usize) {
        let members = &self.layers[layer].members;
        let ids: Vec<KeyframeId> =
            members.iter().rev().take(MOVED_AT_ONCE).map(|member| member.keyframe.id).collect();
        let members = ids.iter().filter_map(|id| self.remove(*id)).collect();
        let mut loadings = Dense::default();
        let moved = self.layers[layer].columns_of(members, &mut loadings);
        let loadings = product(&self.layers[layer].onward, &loadings);
        self.put_all(layer + 1, moved, &loadings);
    }

    /// Lets a layer turn to a waist of what follows it.
    fn search_waist(&mut self, layer: usize) {
        let source = &mut self.layers[layer];
        source.searched = true;
        if let Some((onward, waist)) = waist(&source.onward, widest(&source.onward)) {
            source.onward = Arc::new(onward);
            self.narrow(layer, waist);
        }
    }

    /// The same for the newest layer, which makes every further step cheaper.
    fn search_running_waist(&mut self, moving: &mut Moving) {
        let running = moving.running();
        if let Some((onward, waist)) = waist(&running, widest(&running)) {
            moving.replace_running(&onward);
            self.narrow(self.layers.len() - 1, waist);
        }
    }

    fn narrow(&mut self, layer: usize, waist: Dense) {
        if let Some(before) = layer.checked_sub(1).map(|before| &mut self.layers[before]) {
            before.onward = Arc::new(product(&waist, &before.onward));
        }
        let layer = &mut self.layers[layer];
        let waiting = layer.members.iter().map(|member| member.keyframe.id).collect();
        layer.narrowing = Some(Narrowing { waist: Arc::new(waist), waiting });
    }

    /// Carries some keyframes of a layer to its waist.
    fn narrow_some(&mut self, layer: usize) {
        let Some(narrowing) = &mut self.layers[layer].narrowing else { return };
        let left = narrowing.waiting.len().saturating_sub(MOVED_AT_ONCE);
        let ids = narrowing.waiting.split_off(left);
        let here = |id: &KeyframeId| {
            let (of, place) = self.place_of(*id)?;
            (of == layer && self.layers[layer].is_wide(&self.layers[layer].members[place])).then_some(*id)
        };
        let ids: Vec<KeyframeId> = ids.iter().filter_map(here).collect();
        let members = ids.iter().filter_map(|id| self.remove(*id)).collect();
        let mut loadings = Dense::default();
        let narrowed = self.layers[layer].columns_of(members, &mut loadings);
        self.put_all(layer, narrowed, &loadings);
        if left == 0 {
            self.layers[layer].narrowing = None;
        }
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
                Some(before) => {
                    before.onward = Arc::new(product(&removed.onward, &before.onward));
                    before.searched = false;
                }
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

    fn put_all(&mut self, layer: usize, keyframes: Vec<HeldKeyframe>, loadings: &Dense) {
        let rows = loadings.nrows();
        for (k, keyframe) in keyframes.into_iter().enumerate() {
            let width = KEYFRAME_DIM * rows;
            self.put(layer, keyframe, &loadings.as_slice()[width * k..width * (k + 1)], rows);
        }
    }

    fn put(&mut self, layer: usize, keyframe: HeldKeyframe, loadings: &[f64], rows: usize) {
        let target = &mut self.layers[layer];
        self.by_last_use.insert(keyframe.last_used, keyframe.id);
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

    /// Of each layer, oldest first: its members, and the rows of their loadings.
    pub fn layers(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        let rows = |layer: &Layer| layer.members.first().map_or(0, |member| member.loadings.nrows());
        self.layers.iter().map(move |layer| (layer.members.len(), rows(layer)))
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

/// The widest waist that is worth one.
fn widest(transition: &Dense) -> usize {
    transition.ncols() * WAIST.0 / WAIST.1
}
