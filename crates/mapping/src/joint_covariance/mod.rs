//! The joint covariance of the refined poses.
//!
//! It is the inverse `P` of the normal equations with the landmarks eliminated, computed column by column.
//!
//! # What a map states
//! Up to [`Form::all_up_to`] keyframes, every block. Beyond, all pairs would make the size of a map grow with the square of its
//! length; the full-scale approximation takes the place of `P`:
//!
//! ```text
//! P~ = U U^T + T o (P - U U^T)        o: element by element
//! ```
//! with `U` of few columns (`anchors`), for the errors common to keyframes, and a remainder between near ones only, tapered by
//! a correlation function `T` of the distance (`taper`). Both terms are covariances, the second one as the product of two
//! (Schur). The diagonal is that of `P`.
//!
//! Where a recording is located in a map whose poses stay as they are, the blocks of the map stay as it states them, and every block of
//! the new poses is stated (`covariance_of_new`).
//!
//! Of a map that defines its own frame, `P` is relative to the map as a whole ([`frame`]). What all lengths are wrong by in common is added to
//! it ([`scale`]).
//!
//! Derivation and figures: `docs/src/derivations/joint-covariance.md`.
//!
//! Source: Sang & Huang, "A full scale approximation of covariance functions for large spatial data sets", JRSS B 2012.

mod anchors;
mod frame;
mod scale;
mod taper;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use adjustment::parallel;
use map::model::{CommonError, KeyframeCrossCovariance};
use nalgebra::{Matrix6, Matrix6xX, Vector3, Vector6};
use protocol::KeyframeId;

use super::camera::Mounting;
use super::stored_poses::Posterior;
use anchors::low_rank_part;
use frame::WholeMapFrame;
use scale::with_common_error;
pub(crate) use scale::{SCALE_SIGMA, ScaleFloor};
use taper::Taper;

/// Maps of up to this many keyframes state the cross-covariance of every pair: that takes up to 23 MB.
const ALL_UP_TO: usize = 400;

/// How much of a covariance is stated.
#[derive(Clone, Copy, Debug)]
struct Form {
    /// Up to so many poses, every block.
    all_up_to: usize,
    /// Beyond, the low-rank part has 6 columns for each of so many poses,
    anchors: usize,
    /// and a pose has blocks of what remains with about so many others, on average.
    neighbours: usize,
}

/// A keyframe of a large map takes about the room of one in a map of [`ALL_UP_TO`]. Up to 2000 keyframes, the variance of a
/// relative pose is then right within a few percent, see the derivation.
const FORM: Form = Form { all_up_to: ALL_UP_TO, anchors: 64, neighbours: 192 };

impl Form {
    /// The form for views each of which is as many keyframes: what a keyframe takes stays the same.
    fn for_keyframes(self, keyframes: usize, views: usize) -> Form {
        let of_views = |count: usize| (count * views).div_ceil(keyframes.max(views).max(1));
        Form { all_up_to: of_views(self.all_up_to), neighbours: of_views(self.neighbours), ..self }
    }
}

/// Covariances and cross-covariances of the keyframes' poses, by view.
pub(super) struct JointCovariance {
    /// Covariance of each pose.
    pub(super) own: BTreeMap<usize, Matrix6<f64>>,
    /// The errors common to poses: `U`, as many columns for each; empty in small maps.
    pub(super) common: BTreeMap<usize, Matrix6xX<f64>>,
    /// `E[e_i e_j^T]` beyond `U_i U_j^T`, with `i < j`; all others are zero.
    pub(super) cross: Vec<(usize, usize, Matrix6<f64>)>,
}

impl JointCovariance {
    /// Only the covariances of single poses.
    pub(super) fn of_independent(own: BTreeMap<usize, Matrix6<f64>>) -> JointCovariance {
        JointCovariance { own, common: BTreeMap::new(), cross: Vec::new() }
    }

    /// Covariance of the difference of the errors of each view but the first to that of the view before, in the order of `views`.
    pub(super) fn relative_to_the_one_before(&self, views: &[usize]) -> Vec<Matrix6<f64>> {
        let stated: BTreeMap<(usize, usize), &Matrix6<f64>> =
            self.cross.iter().map(|(i, j, block)| ((*i, *j), block)).collect();
        let together = |a: usize, b: usize| {
            let transposed = || stated.get(&(b, a)).map(|block| block.transpose());
            let near = stated.get(&(a, b)).map(|block| **block).or_else(transposed);
            let common = self.common.get(&a).zip(self.common.get(&b)).map(|(a, b)| a * b.transpose());
            near.unwrap_or_else(Matrix6::zeros) + common.unwrap_or_else(Matrix6::zeros)
        };
        let relative = |pair: &[usize]| {
            let cross = together(pair[0], pair[1]);
            self.own[&pair[0]] + self.own[&pair[1]] - cross - cross.transpose()
        };
        views.windows(2).map(relative).collect()
    }

    /// Cross-covariances and common errors as a map states them. Those of the keyframes of one view are what their mounting makes of
    /// the covariance of its pose.
    ///
    /// # Arguments
    /// * `keyframes`: the keyframes that a view is.
    pub(super) fn of_keyframes(
        &self,
        keyframes: impl Fn(usize) -> Vec<StatedKeyframe>,
    ) -> (Vec<KeyframeCrossCovariance>, Vec<CommonError>) {
        let keyframes: BTreeMap<usize, Vec<StatedKeyframe>> =
            self.own.keys().map(|&view| (view, keyframes(view))).collect();
        let mut cross = Vec::new();
        for (i, j, block) in &self.cross {
            for a in &keyframes[i] {
                cross.extend(keyframes[j].iter().map(|b| a.with(b, block)));
            }
        }
        for (view, of_view) in keyframes.iter().filter(|(_, of_view)| of_view.len() > 1) {
            let common =
                self.common.get(view).map_or_else(Matrix6::zeros, |common| common * common.transpose());
            let rest = self.own[view] - common;
            for (index, b) in of_view.iter().enumerate() {
                cross.extend(of_view[..index].iter().map(|a| a.with(b, &rest)));
            }
        }
        let mut common = Vec::new();
        for (view, factor) in &self.common {
            common.extend(keyframes[view].iter().map(|keyframe| keyframe.common(factor)));
        }
        (cross, common)
    }
}

/// A keyframe of a view.
pub(super) struct StatedKeyframe {
    /// Its name in the map.
    pub(super) id: KeyframeId,
    /// How its error depends on that of the view's pose; `None` where it is the same.
    pub(super) mounting: Option<Mounting>,
}

impl StatedKeyframe {
    /// The only keyframe of a view, whose pose is the view's.
    pub(super) fn alone(id: KeyframeId) -> Vec<StatedKeyframe> {
        vec![StatedKeyframe { id, mounting: None }]
    }

    fn with(&self, other: &StatedKeyframe, of_views: &Matrix6<f64>) -> KeyframeCrossCovariance {
        let mut block = *of_views;
        if let Some(Mounting { jacobian }) = &self.mounting {
            block = jacobian * block;
        }
        if let Some(Mounting { jacobian }) = &other.mounting {
            block *= jacobian.transpose();
        }
        KeyframeCrossCovariance { a: self.id, b: other.id, block }.ordered()
    }

    fn common(&self, of_view: &Matrix6xX<f64>) -> CommonError {
        let factor = self.mounting.map_or_else(|| of_view.clone(), |mounting| mounting.jacobian * of_view);
        CommonError { keyframe: self.id, factor }
    }
}

/// What is stated of the frame and of the scale of all views, beyond what the adjustment says.
#[derive(Clone, Debug)]
pub(super) enum FrameAndScale {
    /// Nothing.
    AsAdjusted,
    /// The views define the frame, whose direction of gravity is this unit vector: relative to the views as a whole, with a common error of
    /// the scale.
    OfTheWhole(Vector3<f64>),
    /// The errors of each view, in order, where the scale is off by one standard deviation.
    WithScaleError(Vec<Vector6<f64>>),
    /// At least so much of the scale.
    WithScaleFloor(ScaleFloor),
}

/// The joint covariance of the poses of some views.
///
/// # Arguments
/// * `keyframes`: how many keyframes the views are.
/// * `posterior`: of the views, which are at `positions` (m).
pub(super) fn joint_covariance(
    posterior: &Posterior<'_>,
    (views, keyframes): (&[usize], usize),
    positions: &[Vector3<f64>],
    frame_and_scale: FrameAndScale,
    progress: impl FnMut(usize, usize),
) -> JointCovariance {
    let column = |j: usize| posterior.column(j);
    let form = FORM.for_keyframes(keyframes, views.len());
    let (own_frame, errors) = match frame_and_scale {
        FrameAndScale::AsAdjusted => (None, Vec::new()),
        FrameAndScale::OfTheWhole(gravity) => (Some(gravity), Vec::new()),
        FrameAndScale::WithScaleError(errors) => (None, errors),
        FrameAndScale::WithScaleFloor(floor) => (None, floor.errors(positions, column)),
    };
    let Blocks { own, common, cross } = match own_frame {
        Some(gravity) => {
            let frame = WholeMapFrame::new(positions, &gravity, column);
            stated(form, positions, |j| frame.column(j), progress)
        }
        None => stated(form, positions, |j| with_common_error(column(j), &errors, j), progress),
    };
    JointCovariance {
        own: views.iter().copied().zip(own).collect(),
        common: views.iter().copied().zip(common).collect(),
        cross: cross.into_iter().map(|(i, j, block)| (views[i], views[j], block)).collect(),
    }
}

/// The covariances of new poses with each other and with those of a map, which states its own ones already: every block, whatever their
/// number.
///
/// An approximation of these alone would leave no covariance together with what the map states, and one of all blocks would approximate
/// those of the map again with every recording that is located in it.
///
/// # Arguments
/// * `views`: the new ones, then those of the map; `new` of them are new.
/// * `posterior`: of these views.
/// * `errors`: of each new view where the scale of the recording is off by one standard deviation. The map does not share this error: what
///   is added is the covariance of the new poses alone, so that the whole stays a covariance.
pub(super) fn covariance_of_new(
    posterior: &Posterior<'_>,
    (views, new): (&[usize], usize),
    errors: &[Vector6<f64>],
    mut progress: impl FnMut(usize, usize),
) -> JointCovariance {
    let mut joint = JointCovariance::of_independent(BTreeMap::new());
    let mut next = 0;
    parallel::for_each(
        new,
        |j| posterior.column(j),
        |column| {
            let j = next;
            next += 1;
            progress(j, new);
            let with_error = |i: usize| column[i] + errors[i] * errors[j].transpose();
            let own = with_error(j);
            joint.own.insert(views[j], (own + own.transpose()) * 0.5);
            joint.cross.extend((0..j).map(|i| (views[i], views[j], with_error(i))));
            joint.cross.extend((new..views.len()).map(|i| (views[j], views[i], column[i].transpose())));
        },
    );
    joint
}

/// A [`JointCovariance`] by the order of the poses.
struct Blocks {
    own: Vec<Matrix6<f64>>,
    /// Empty where all blocks are in `cross`.
    common: Vec<Matrix6xX<f64>>,
    cross: Vec<(usize, usize, Matrix6<f64>)>,
}

/// What is stated of a covariance.
///
/// # Arguments
/// * `positions`: of the poses (m).
/// * `column`: `P_:j`, a block for each pose.
fn stated(
    form: Form,
    positions: &[Vector3<f64>],
    column: impl Fn(usize) -> Vec<Matrix6<f64>> + Sync,
    mut progress: impl FnMut(usize, usize),
) -> Blocks {
    let count = positions.len();
    let taper = (count > form.all_up_to).then(|| Taper::with_mean_neighbours(positions, form.neighbours));
    let kept = |i: usize, j: usize| taper.map_or(1.0, |taper| taper.kept(&positions[i], &positions[j]));
    let mut blocks = Blocks { own: Vec::with_capacity(count), common: Vec::new(), cross: Vec::new() };
    parallel::for_each(count, &column, |column| {
        let j = blocks.own.len();
        progress(j, count);
        blocks.own.push((column[j] + column[j].transpose()) * 0.5);
        let near = (0..j).filter(|&i| kept(i, j) > 0.0);
        blocks.cross.extend(near.map(|i| (i, j, column[i])));
    });
    if taper.is_some() {
        blocks.common = low_rank_part(&blocks.own, form.anchors, column);
        for (i, j, block) in &mut blocks.cross {
            let together = &blocks.common[*i] * blocks.common[*j].transpose();
            *block = (*block - together) * kept(*i, *j);
        }
    }
    blocks
}
