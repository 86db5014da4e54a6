//! How the errors of new keyframes depend on those of all keyframes of a map, when they were located in a part of it.
//!
//! What locates them concerns the part only, so that with `p` its errors, `Λ` the inverse of their stated covariance, and `C` the covariance
//! of the new errors with them,
//!
//! ```text
//! e_new = A p + rest,    A = C Λ,    rest independent of all errors of the map
//! ```
//! The map states `P = U U^T + R`, with the common errors `U` and a sparse `R`, and the new keyframes are stated in the same form:
//!
//! ```text
//! U_new = A U_p,    R_new,j = A R_pj,    R_new,new = P_new,new - U_new U_new^T
//! ```
//! Derivation: `docs/src/derivations/joint-covariance.md`.

use std::collections::{BTreeMap, BTreeSet};

use adjustment::{POSE, inverse_of};
use map::contents::MapContents;
use map::model::{CommonError, KeyframeCrossCovariance};
use nalgebra::{DMatrix, Matrix6, Matrix6xX};
use protocol::KeyframeId;

use crate::stored_poses::MapCovariance;

/// Of what common errors leave, covariances with keyframes outside of the part are left out where all their correlations are smaller.
const NEGLIGIBLE: f64 = 1e-3;

/// What a map states of the errors of new keyframes beside the covariance of each.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LocatedErrors {
    pub(crate) common: Vec<CommonError>,
    /// With keyframes of the map, and with each other.
    pub(crate) cross: Vec<KeyframeCrossCovariance>,
}

/// The errors of new keyframes in the form of the map that they were located in.
///
/// # Arguments
/// * `map`: sorted; without them.
/// * `part`: the keyframes of the map that they were located in; all of them where it was located in the whole map.
/// * `extended`: the part of the map and the new keyframes, sorted, with the poses of the part as in the map.
///
/// # Returns
/// `None` where the map states no covariance of the part that is positive definite.
pub fn located_errors(
    map: &MapContents,
    part: &BTreeSet<KeyframeId>,
    extended: &MapContents,
) -> Option<LocatedErrors> {
    let within = |id: &KeyframeId| part.contains(id);
    let ids = |contents: &MapContents, is_of_part: bool| -> Vec<usize> {
        let keyframes = contents.keyframes.iter().enumerate();
        keyframes.filter(|(_, keyframe)| within(&keyframe.id) == is_of_part).map(|(at, _)| at).collect()
    };
    let (of_part, new) = (ids(extended, true), ids(extended, false));
    let together = MapCovariance::of_map(extended)?;
    let all: Vec<usize> = of_part.iter().chain(&new).copied().collect();
    let together = together.of_keyframes(&all);
    let (first, count) = (POSE * of_part.len(), POSE * new.len());
    let stated = MapCovariance::of_part(map, part)?;
    let information = inverse_of(&stated.of_all())?;
    let gain = together.view((first, 0), (count, first)) * information;
    let common = &gain * stated.common();
    let id = |at: &usize| extended.keyframes[*at].id;
    let mut cross = Vec::new();
    let mut push = |a: KeyframeId, b: KeyframeId, block: Matrix6<f64>| {
        cross.push(KeyframeCrossCovariance { a, b, block }.ordered());
    };
    // With the part, and with each other.
    let of_map = &common * stated.common().transpose();
    let rest = together.view((first, 0), (count, first)) - of_map;
    let own = together.view((first, first), (count, count)) - &common * common.transpose();
    for (row, a) in new.iter().enumerate() {
        for (column, b) in of_part.iter().enumerate() {
            push(id(a), id(b), rest.fixed_view::<POSE, POSE>(POSE * row, POSE * column).into());
        }
        for (column, b) in new.iter().enumerate().skip(row + 1) {
            push(id(a), id(b), own.fixed_view::<POSE, POSE>(POSE * row, POSE * column).into());
        }
    }
    // With the rest of the map.
    for (keyframe, columns) in columns_outside(map, part) {
        let mut of_new: DMatrix<f64> = DMatrix::zeros(count, POSE);
        for (at, block) in columns {
            of_new.gemm(1.0, &gain.columns(POSE * at, POSE), &block, 1.0);
        }
        let position = map.keyframes.binary_search_by_key(&keyframe, |of| of.id).ok()?;
        let sigmas = map.keyframes[position].global_from_keyframe.covariance.diagonal().map(f64::sqrt);
        for (row, a) in new.iter().enumerate() {
            let block: Matrix6<f64> = of_new.fixed_view::<POSE, POSE>(POSE * row, 0).into();
            let own = extended.keyframes[*a].global_from_keyframe.covariance.diagonal().map(f64::sqrt);
            let scale = own * sigmas.transpose();
            if block.zip_map(&scale, |value, scale| value.abs() > NEGLIGIBLE * scale).iter().any(|is| *is) {
                push(id(a), keyframe, block);
            }
        }
    }
    let has_common = !map.common_errors.is_empty();
    let factor = |row: usize| Matrix6xX::from(common.fixed_rows::<POSE>(POSE * row));
    let common = new.iter().enumerate().filter(|_| has_common);
    let common = common.map(|(row, at)| CommonError { keyframe: id(at), factor: factor(row) });
    Some(LocatedErrors { common: common.collect(), cross })
}

/// The blocks of `R` of the keyframes outside of a part with those in it: for each the position in the part and `R_pj`.
fn columns_outside(
    map: &MapContents,
    part: &BTreeSet<KeyframeId>,
) -> BTreeMap<KeyframeId, Vec<(usize, Matrix6<f64>)>> {
    let positions: BTreeMap<KeyframeId, usize> = part.iter().copied().zip(0..).collect();
    let mut columns: BTreeMap<KeyframeId, Vec<(usize, Matrix6<f64>)>> = BTreeMap::new();
    for cross in &map.cross_covariances {
        match (positions.get(&cross.a), positions.get(&cross.b)) {
            (Some(&at), None) => columns.entry(cross.b).or_default().push((at, cross.block)),
            (None, Some(&at)) => columns.entry(cross.a).or_default().push((at, cross.block.transpose())),
            _ => {}
        }
    }
    columns
}
