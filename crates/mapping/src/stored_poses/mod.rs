//! The keyframe poses of a stored map in an adjustment that sees some of them again.
//!
//! Measurements concern the *tied* keyframes `T` only: their poses are adjusted, with the map's covariance of them as a joint prior.
//! The others `R` follow, since the map says how their errors are correlated with those of `T`:
//!
//! ```text
//! e_R = G e_T + rest,    G = P_RT P_TT^-1,    cov(rest) = P_RR - G P_TR,    rest independent of e_T
//! ```
//! This is the same as adjusting all poses of the map; the dense matrix is that of `T`.
//!
//! Without its frame (`without_frame`) a map says nothing of yaw and position of the whole: with `M` their effect on the poses, and
//! `Λ = P_TT^-1`,
//!
//! ```text
//! e_R = G e_T + (M_R - G M_T) a + rest,    a ~ N(W e_T, A),    A = (M_T^T Λ M_T)^-1,    W = A M_T^T Λ
//! ```
//! Derivation: `docs/src/derivations/joint-covariance.md`; with a free frame it is universal kriging.
//!
//! Source: Cressie, "Statistics for Spatial Data", 1993, section 3.4.

mod covariance;
mod posterior;
#[cfg(test)]
mod tests;

use std::sync::Arc;

use adjustment::{JointPrior, POSE, PosePrior, inverse_of, pose_errors};
use geometry::pose::Pose;
use map::contents::MapContents;
use nalgebra::{DMatrix, Matrix6, Vector3};

pub(crate) use covariance::MapCovariance;
use covariance::{bounded, rows_of};
pub(crate) use posterior::Posterior;

/// Yaw and position of a map.
const MODES: usize = 4;

/// The keyframe poses of a map, some of which are tied to others by measurements.
pub(crate) struct StoredPoses {
    /// The view of the first keyframe; the others follow in the order of the map.
    first: usize,
    /// Means, `global_from_camera`.
    means: Vec<Pose>,
    /// The covariance of each keyframe, as the map states it.
    stated: Vec<Matrix6<f64>>,
    /// P, with the lower bound of [`MapCovariance`].
    covariance: MapCovariance,
    /// T, in order.
    tied: Vec<usize>,
    /// Of each keyframe, whether it is one of R.
    follows: Vec<bool>,
    /// Λ.
    information: Arc<DMatrix<f64>>,
    /// Where the map says nothing of its frame.
    frame: Option<FreeFrame>,
    /// The poses and their covariance stay as the map states them.
    is_considered: bool,
}

/// Yaw and position of a map, of which nothing is known.
struct FreeFrame {
    /// M, 6 rows a keyframe.
    modes: DMatrix<f64>,
    /// `M_T`.
    modes_of_tied: DMatrix<f64>,
    /// A.
    covariance: DMatrix<f64>,
    /// W.
    weights: DMatrix<f64>,
    /// `Λ - Λ M_T W`.
    information: Arc<DMatrix<f64>>,
}

/// How a keyframe of R depends on those of T, and what remains of it.
struct Dependence {
    /// The column of the keyframe in P.
    column: DMatrix<f64>,
    /// `P_TT^-1 P_Tj`.
    gain: DMatrix<f64>,
    /// `(M_j - G_j M_T)^T`, with a free frame.
    by_frame: Option<DMatrix<f64>>,
}

impl StoredPoses {
    /// The keyframes of a map, in its order, as the views from `first` on.
    ///
    /// # Arguments
    /// * `tied`: positions in the map, in order.
    ///
    /// # Returns
    /// `None` where their covariance is not positive definite.
    pub(crate) fn of_map(contents: &MapContents, first: usize, tied: Vec<usize>) -> Option<StoredPoses> {
        let covariance = MapCovariance::of_map(contents)?;
        let information = Arc::new(inverse_of(&covariance.of_keyframes(&tied))?);
        let mut follows = vec![true; covariance.len()];
        for &keyframe in &tied {
            follows[keyframe] = false;
        }
        let poses = || contents.keyframes.iter().map(|keyframe| keyframe.global_from_keyframe);
        Some(StoredPoses {
            first,
            means: poses().map(|pose| pose.pose).collect(),
            stated: poses().map(|pose| pose.covariance).collect(),
            covariance,
            tied,
            follows,
            information,
            frame: None,
            is_considered: false,
        })
    }

    /// The same, but what is measured changes neither the poses of the map nor their covariance: it locates the other views in them.
    ///
    /// With the gain of the adjustment for the other views and none for those of the map, the covariance of Schmidt 1966 is that of the
    /// adjustment for the other views and between these and the map, and the stated one within the map.
    pub(crate) fn considered(self) -> StoredPoses {
        StoredPoses { is_considered: true, ..self }
    }

    /// The same without what the map says of its yaw and position: of the keyframes relative to each other.
    pub(crate) fn without_frame(mut self) -> Option<StoredPoses> {
        let mut modes = DMatrix::zeros(POSE * self.means.len(), MODES);
        for (at, pose) in self.means.iter().enumerate() {
            modes[(POSE * at + 2, 0)] = 1.0;
            let by_yaw = Vector3::z().cross(&pose.translation);
            modes.fixed_view_mut::<3, 1>(POSE * at + 3, 0).copy_from(&by_yaw);
            modes.fixed_view_mut::<3, 3>(POSE * at + 3, 1).fill_with_identity();
        }
        let modes_of_tied = rows_of(&modes, &self.tied);
        let weighted = &*self.information * &modes_of_tied;
        let covariance = modes_of_tied.tr_mul(&weighted).cholesky()?.inverse();
        let weights = &covariance * weighted.transpose();
        let information = Arc::new(&*self.information - weighted * &weights);
        self.frame = Some(FreeFrame { modes, modes_of_tied, covariance, weights, information });
        Some(self)
    }

    /// The views of T.
    pub(crate) fn tied_views(&self) -> impl Iterator<Item = usize> {
        self.tied.iter().map(|keyframe| self.first + keyframe)
    }

    /// The covariance of each keyframe by its view, as the map states it. One that the map takes for exact has the lower bound with which
    /// it takes part in an adjustment: what is located in it has cross-covariances with it.
    pub(crate) fn stated(&self) -> impl Iterator<Item = (usize, Matrix6<f64>)> {
        self.stated.iter().enumerate().map(|(keyframe, stated)| (self.first + keyframe, bounded(stated)))
    }

    /// What the map says of the poses of T.
    pub(crate) fn prior(&self) -> JointPrior {
        let information = self.frame.as_ref().map_or(&self.information, |frame| &frame.information);
        let means = self.tied.iter().map(|&keyframe| self.means[keyframe]).collect();
        JointPrior::new(self.tied_views().collect(), means, Arc::clone(information))
    }

    /// Priors that leave the poses of R where they are while those of T are adjusted.
    pub(crate) fn held(&self) -> impl Iterator<Item = PosePrior> {
        let of_keyframe = |keyframe| PosePrior {
            view: self.first + keyframe,
            pose: self.means[keyframe],
            information: Matrix6::identity(),
        };
        (0..self.means.len()).filter(|&keyframe| self.follows[keyframe]).map(of_keyframe)
    }

    /// Moves the poses of R to where those of T say.
    ///
    /// # Arguments
    /// * `poses`: of all views.
    pub(crate) fn follow(&self, poses: &mut [Pose]) {
        let of_tied: Vec<Pose> = self.tied.iter().map(|&keyframe| self.means[keyframe]).collect();
        let error = pose_errors(&of_tied, self.tied_views().map(|view| &poses[view]));
        let followed = self.propagated(&DMatrix::from_column_slice(error.len(), 1, error.as_slice()), None);
        for (keyframe, mean) in self.means.iter().enumerate().filter(|(at, _)| self.follows[*at]) {
            let error = followed.fixed_view::<POSE, 1>(POSE * keyframe, 0).into_owned();
            poses[self.first + keyframe] = mean.retract(&error);
        }
    }

    /// Moves all poses of the map to where it states them.
    ///
    /// # Arguments
    /// * `poses`: of all views.
    pub(crate) fn reset(&self, poses: &mut [Pose]) {
        poses[self.first..self.first + self.means.len()].copy_from_slice(&self.means);
    }

    /// How a keyframe of R depends on those of T.
    fn dependence(&self, keyframe: usize) -> Dependence {
        let column = self.covariance.column(keyframe);
        let gain = &*self.information * rows_of(&column, &self.tied);
        let by_frame = self.frame.as_ref().map(|frame| {
            let own = frame.modes.rows(POSE * keyframe, POSE).transpose();
            own - frame.modes_of_tied.tr_mul(&gain)
        });
        Dependence { column, gain, by_frame }
    }

    /// The transpose of the matrix that gives the error of a keyframe of R from those of T.
    fn total_gain(&self, dependence: &Dependence) -> DMatrix<f64> {
        match (&self.frame, &dependence.by_frame) {
            (Some(frame), Some(by_frame)) => &dependence.gain + frame.weights.tr_mul(by_frame),
            _ => dependence.gain.clone(),
        }
    }

    /// What the errors of all keyframes are, given those of T, or the covariances of all keyframes with something, given those of
    /// T with it. Only the rows of R are defined.
    ///
    /// # Arguments
    /// * `own`: the keyframe of R whose column this is: what remains of it is correlated with what remains of others.
    fn propagated(&self, of_tied: &DMatrix<f64>, own: Option<&Dependence>) -> DMatrix<f64> {
        let mut of_tied = of_tied.clone();
        let mut by_frame = None;
        if let Some(frame) = &self.frame {
            let mut of_frame = &frame.weights * &of_tied;
            if let Some(own) = own.and_then(|own| own.by_frame.as_ref()) {
                of_frame += &frame.covariance * own;
            }
            of_tied -= &frame.modes_of_tied * &of_frame;
            by_frame = Some(&frame.modes * of_frame);
        }
        let mut weights = &*self.information * of_tied;
        if let Some(own) = own {
            weights -= &own.gain;
        }
        let mut all = self.covariance.times(&self.tied, &weights, &self.follows);
        if let Some(by_frame) = by_frame {
            all += by_frame;
        }
        if let Some(own) = own {
            all += &own.column;
        }
        all
    }
}
