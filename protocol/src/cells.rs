//! `map/{map}/cell/{cell}/match` and `../localize`: what a server of some cells of a map answers to the server that a robot asked.
//!
//! The answer is that of a map of this cell alone, with the place that it is about: the server that asked compares the places of
//! several cells, and passes on the answer of one.

use crate::localize::LocalizeReply;
use crate::matching::MatchReply;
use crate::validate::{InvalidField, Validate, require, require_each, require_valid};
use crate::wire;
use geometry::uncertain_pose::PoseWithCovariance;
use serde::{Deserialize, Serialize};

/// The place that explains an image, or where several do the strongest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CellPlace {
    /// The camera in the map's frame.
    #[serde(with = "wire::PoseForm")]
    pub global_from_camera: PoseWithCovariance,
    /// Query features that it explains.
    pub features: u32,
}

impl Validate for CellPlace {
    fn validate(&self) -> Result<(), InvalidField> {
        require_valid(&self.global_from_camera, "global_from_camera")
    }
}

/// The answer of one cell to a [`MatchRequest`](crate::MatchRequest).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CellMatchReply {
    /// The parts of the answer, the last of them [`MatchReply::Done`].
    pub replies: Vec<MatchReply>,
    /// What it is about.
    #[serde(default)]
    pub place: Option<CellPlace>,
}

impl Validate for CellMatchReply {
    fn validate(&self) -> Result<(), InvalidField> {
        require_each(&self.replies, "replies", Validate::validate)?;
        let ends = self.replies.iter().filter(|reply| matches!(reply, MatchReply::Done(_))).count();
        let last = matches!(self.replies.last(), Some(MatchReply::Done(_)));
        require(ends == 1 && last, "replies", "does not end with `done`")?;
        require_valid(self.place.as_ref(), "place")
    }
}

/// The answer of one cell to a [`LocalizeRequest`](crate::LocalizeRequest).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CellLocalizeReply {
    /// The answer.
    pub reply: LocalizeReply,
    /// What it is about.
    #[serde(default)]
    pub place: Option<CellPlace>,
}

impl Validate for CellLocalizeReply {
    fn validate(&self) -> Result<(), InvalidField> {
        require_valid(&self.reply, "reply")?;
        require_valid(self.place.as_ref(), "place")
    }
}
