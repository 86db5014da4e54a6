//! What the filter does when the map that it uses changes: versions of answers, and changes that the map's server states.
//!
//! # A stated change
//! `global_from_local` stays, and errs from now on by how far the map moved under the robot, too. That is a pose error of G
//! at the place of the robot: G turns about that place by `τ` (rad, in L) and moves by `σ` (metres, in L). With `q` the robot's
//! position in L and the error of `global_from_local` told in L (`state::retract_locally`),
//! ```text
//! R' = R Exp(τ),   p' = p + R (q + σ - Exp(τ) q)      so      e_θ = τ,   e_p = [q]ₓ τ + σ
//! Q = J diag(σ_θ² I, σ_p² I) Jᵀ,   J = [ I 0; [q]ₓ I ]
//! ```
//! The pose of the robot in G becomes more uncertain by exactly the stated sizes; the distance to the origin of G has no
//! part in it. The noises of several changes in a row add up.
//!
//! # What is held of the old version
//! * Keyframes that the new version states as the old one did have the same errors. They stay held, with their correlation
//!   with the state; adding keyframes to a map costs nothing.
//! * Keyframes that moved or are gone are given up. The new version's errors may depend on theirs in any way, so the
//!   state and the new version are made as uncertain as it takes to use them as independent (`nuisance::given_up`). That
//!   holds for the same id and for new ids alike: both may be of the same images.
//! * How new ids depend on keyframes that stayed, the new version states in its cross-covariances, as any map does.
//!
//! # Which answers count
//! A change is taken in when its news come. Answers to images from before that are of another version are late ones. An
//! answer of a version without news may be faster than these: it is left out for [`NEWS_NS`], and then, or where the news
//! do not state the change from the version that is held (one was lost), the map is another one: `global_from_local` is
//! found anew with its wide prior, and all keyframes are given up.

use crate::KeyframeId;
use crate::map_update::map_answer::MapAnswer;
use crate::map_update::map_report::{MapReport, Rejection};
use crate::state::{Block, CloneId, POSE_DIM};
use crate::{Estimator, EstimatorError};
use nalgebra::{Matrix6, Vector3};

/// How long after the first answer of a version its news may come, nanoseconds of the images' time. Both leave the server
/// within milliseconds of each other; a recording that is played as fast as possible takes some of them a second.
const NEWS_NS: i64 = 2_000_000_000;

/// How far a map moved: standard deviations of a pose error of its frame, at any place of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChangeSize {
    /// Rotation, rad an axis.
    pub sigma_rotation: f64,
    /// Position, metres an axis.
    pub sigma_position: f64,
}

/// News of the map.
#[derive(Clone, Debug, PartialEq)]
pub struct MapRevision {
    /// The version that changed.
    pub from_version: u64,
    /// What it changed to.
    pub version: u64,
    /// Keyframes whose pose, covariance or cross-covariances are others, or that are gone.
    pub other_errors: Vec<KeyframeId>,
    /// How far it moved, where that is stated.
    pub size: Option<ChangeSize>,
}

/// What news of the map came to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RevisionEffect {
    /// `global_from_local` was carried over to the new version, with noise.
    CarriedOver,
    /// The next answer of the new version finds `global_from_local` anew.
    FoundAnew,
    /// The filter uses no version of the map yet, or this one already.
    None,
}

/// Which version of the map is in use.
#[derive(Clone, Debug)]
pub(crate) struct MapVersion {
    /// The one that the held keyframes are of.
    pub(crate) held: Option<u64>,
    /// Time of the newest image when it came into use.
    since_ns: i64,
    /// Another one that answered without news, and the time of the newest image then.
    without_news: Option<(u64, i64)>,
    /// One that is to be found anew, by its news.
    to_be_found: Option<u64>,
}

impl Default for MapVersion {
    fn default() -> Self {
        Self { held: None, since_ns: i64::MIN, without_news: None, to_be_found: None }
    }
}

impl MapVersion {
    /// Whether news of this version may still come.
    fn waits_for_news(&mut self, version: u64, now_ns: i64) -> bool {
        if self.to_be_found == Some(version) {
            return false;
        }
        match self.without_news {
            Some((other, since_ns)) if other == version => now_ns - since_ns < NEWS_NS,
            _ => {
                self.without_news = Some((version, now_ns));
                true
            }
        }
    }

    fn begin(&mut self, version: u64, since_ns: i64) {
        *self = Self { held: Some(version), since_ns, ..Self::default() };
    }
}

impl Estimator {
    /// Takes in news of the map; see the module's text.
    ///
    /// Call it as soon as they are there, before answers that came later.
    pub fn map_changed(&mut self, revision: &MapRevision) -> RevisionEffect {
        let Some(held) = self.map_version.held.filter(|held| *held != revision.version) else {
            return RevisionEffect::None;
        };
        let linear = |size: &ChangeSize| {
            // Beyond its prior nothing of `global_from_local` is worth keeping.
            (0.0..=self.config.transform_sigma_rotation).contains(&size.sigma_rotation)
                && (0.0..f64::INFINITY).contains(&size.sigma_position)
        };
        match revision.size.filter(linear) {
            Some(size) if held == revision.from_version => {
                self.move_map_by(size);
                self.covariance.invalidate(&revision.other_errors);
                self.contradiction = None;
                self.rejections_in_a_row = 0;
                let newest = self.state.clones.last();
                let since_ns = newest.map_or(self.state.stamp_ns, |clone| clone.stamp_ns);
                self.map_version.begin(revision.version, since_ns);
                RevisionEffect::CarriedOver
            }
            _ => {
                self.map_version.to_be_found = Some(revision.version);
                RevisionEffect::FoundAnew
            }
        }
    }

    /// Process noise of `global_from_local`.
    fn move_map_by(&mut self, size: ChangeSize) {
        if let Some(range) = self.state.range(Block::Transform) {
            let noise = transform_noise(&self.state.imu.local_from_imu.translation, size);
            self.covariance.add_noise(range.start, &noise);
        }
    }

    /// Takes in an answer of the version in use; of another one as the module's text says. If `global_from_local` cannot
    /// be found anew by it, all stays as it was.
    pub(crate) fn in_map_version(
        &mut self,
        clone: CloneId,
        answer: &MapAnswer,
        report: &mut MapReport,
    ) -> Result<Result<(), Rejection>, EstimatorError> {
        let answered = answer.map_version;
        let asked_ns = self.state.place_of(clone).map_or(i64::MIN, |place| self.state.clones[place].stamp_ns);
        if let Some(held) = self.map_version.held {
            if answered == held {
                return self.try_map_update(clone, answer, report);
            }
            if asked_ns <= self.map_version.since_ns {
                return Ok(Err(Rejection::OldMap { answered, held }));
            }
            let localized = self.state.transform.is_some();
            if self.map_version.waits_for_news(answered, self.state.stamp_ns) && localized {
                return Ok(Err(Rejection::NewMap { answered, held }));
            }
        }
        let before = (self.state.clone(), self.covariance.clone());
        self.remove_transform();
        self.covariance.invalidate(&self.held_keyframes());
        let outcome = self.try_map_update(clone, answer, report)?;
        if outcome.is_err() {
            (self.state, self.covariance) = before;
        } else {
            self.map_version.begin(answered, asked_ns);
        }
        Ok(outcome)
    }
}

/// Covariance of the error of `global_from_local` by a move of G at a place; see the module's text.
///
/// # Arguments
/// * `place`: in L, metres.
fn transform_noise(place: &Vector3<f64>, size: ChangeSize) -> Matrix6<f64> {
    let mut by_move = Matrix6::identity();
    by_move.fixed_view_mut::<3, 3>(POSE_DIM / 2, 0).copy_from(&place.cross_matrix());
    let variance =
        |k: usize| if k < POSE_DIM / 2 { size.sigma_rotation } else { size.sigma_position }.powi(2);
    let of_move = Matrix6::from_diagonal(&nalgebra::Vector6::from_fn(|k, _| variance(k)));
    by_move * of_move * by_move.transpose()
}
