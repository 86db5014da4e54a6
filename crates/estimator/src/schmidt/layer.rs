//! Keyframes that were parked together, and the way from there to the next layer.

use super::HeldKeyframe;
use super::packed::Packed;
use crate::KeyframeId;
use crate::linear_algebra::dense::Dense;
use faer::linalg::matmul::triangular::BlockStructure;
use std::sync::Arc;

/// A keyframe that waits.
#[derive(Clone, Debug)]
pub struct ParkedKeyframe {
    pub keyframe: HeldKeyframe,
    /// Shared by the copies of a filter, which try a step and are thrown away.
    pub loadings: Arc<Packed>,
}

/// See the module's text.
#[derive(Clone, Debug)]
pub struct Layer {
    /// Grows from layer to layer, in their order.
    pub serial: u64,
    pub members: Vec<ParkedKeyframe>,
    /// From here to the next layer. Not used in the newest.
    pub onward: Arc<Dense>,
    /// Whether a waist of `onward` was looked for.
    pub searched: bool,
    pub narrowing: Option<Narrowing>,
}

/// `onward` begins at the waist already, but some members have as many rows as before.
#[derive(Clone, Debug)]
pub struct Narrowing {
    /// `C`.
    pub waist: Arc<Dense>,
    /// These have, if they are still here.
    pub waiting: Vec<KeyframeId>,
}

impl Layer {
    /// Loadings of some of its members as columns, in the rows that `onward` takes, behind those in `columns`; and whose
    /// they are, in that order.
    pub fn columns_of(&self, members: Vec<ParkedKeyframe>, columns: &mut Dense) -> Vec<HeldKeyframe> {
        let mut order = Vec::with_capacity(members.len());
        let (wide, narrow): (Vec<_>, Vec<_>) = members.into_iter().partition(|member| self.is_wide(member));
        let mut append = |members: Vec<ParkedKeyframe>, target: &mut Dense| {
            for member in members {
                if target.ncols() == 0 {
                    target.reset(member.loadings.nrows(), 0);
                }
                target.extend_columns(member.loadings.numbers());
                order.push(member.keyframe);
            }
        };
        if let Some(narrowing) = self.narrowing.as_ref().filter(|_| !wide.is_empty()) {
            let mut before = Dense::default();
            append(wide, &mut before);
            let after = product(&narrowing.waist, &before);
            if columns.ncols() == 0 {
                columns.reset(after.nrows(), 0);
            }
            columns.extend_columns(after.as_slice().iter().copied());
        }
        append(narrow, columns);
        order
    }

    pub fn is_wide(&self, member: &ParkedKeyframe) -> bool {
        self.narrowing.as_ref().is_some_and(|narrowing| member.loadings.nrows() == narrowing.waist.ncols())
    }
}

/// `left right`.
pub fn product(left: &Dense, right: &Dense) -> Dense {
    let mut product = Dense::zeros(left.nrows(), right.ncols());
    product.add_product(left, 0..left.ncols(), right, 0..right.nrows(), BlockStructure::Rectangular);
    product
}
