//! The kinds of records.

/// What a record holds. Its name is part of the record's checksum.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Table {
    /// Keyframes, by id.
    Keyframes,
    /// Landmarks with their observations, by id.
    Landmarks,
    /// 6x6 blocks of pairs of keyframes, by the ids of both.
    CrossCovariances,
    /// Parts of the common error, by keyframe.
    CommonErrors,
    /// Places that keyframes could be taken for, by keyframe.
    Aliases,
    /// Images of keyframes, by keyframe.
    Images,
    /// Whether landmarks are still there, by landmark.
    Existence,
}

impl Table {
    /// The name in checksums and digests.
    pub fn name(self) -> &'static str {
        match self {
            Table::Keyframes => "keyframes",
            Table::Landmarks => "landmarks",
            Table::CrossCovariances => "cross_covariances",
            Table::CommonErrors => "common_errors",
            Table::Aliases => "aliases",
            Table::Images => "images",
            Table::Existence => "existence",
        }
    }

    /// A record's name in messages.
    pub(crate) fn describe(self, key: &[u64]) -> String {
        let ids = key.iter().map(u64::to_string).collect::<Vec<_>>().join(" and ");
        match self {
            Table::Keyframes => format!("keyframe {ids}"),
            Table::Landmarks => format!("landmark {ids}"),
            Table::CrossCovariances => format!("the cross-covariance of keyframes {ids}"),
            Table::CommonErrors => format!("the common error of keyframe {ids}"),
            Table::Aliases => format!("the aliases of keyframe {ids}"),
            Table::Images => format!("the image of keyframe {ids}"),
            Table::Existence => format!("the existence of landmark {ids}"),
        }
    }
}
