//! Kinds of queries, and what they are about: a map, or one cell of a map.

use protocol::keys::{self, NameError};
use releases::CellId;

/// A kind of query about one map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Match,
    Localize,
    Info,
    Keyframes,
}

impl Kind {
    pub(crate) const ALL: [Kind; 4] = [Kind::Match, Kind::Localize, Kind::Info, Kind::Keyframes];

    /// Its name in metrics.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Kind::Match => "match",
            Kind::Localize => "localize",
            Kind::Info => "info",
            Kind::Keyframes => "keyframes",
        }
    }

    /// The key expression of its queryable for a map.
    pub(crate) fn key(self, map: &str) -> Result<String, NameError> {
        match self {
            Kind::Match => keys::map_match(map),
            Kind::Localize => keys::map_localize(map),
            Kind::Info => keys::map_info(map),
            Kind::Keyframes => keys::map_keyframes(map),
        }
    }

    /// The key expression for maps of any name.
    pub(crate) fn key_of_any_map(self) -> &'static str {
        match self {
            Kind::Match => "map/*/match",
            Kind::Localize => "map/*/localize",
            Kind::Info => "map/*/info",
            Kind::Keyframes => "map/*/keyframes/*",
        }
    }
}

/// A kind of query that one cell of a map answers by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CellKind {
    Match,
    Localize,
    Keyframes,
}

impl CellKind {
    pub(crate) const ALL: [CellKind; 3] = [CellKind::Match, CellKind::Localize, CellKind::Keyframes];

    /// Its name in metrics: queries to cells are counted beside those that they are asked for.
    pub(crate) fn name(self) -> &'static str {
        match self {
            CellKind::Match => "cell_match",
            CellKind::Localize => "cell_localize",
            CellKind::Keyframes => "cell_keyframes",
        }
    }

    /// The key expression of its queryable for a cell of a map.
    pub(crate) fn key(self, map: &str, cell: CellId) -> Result<String, NameError> {
        match self {
            CellKind::Match => keys::cell_match(map, cell),
            CellKind::Localize => keys::cell_localize(map, cell),
            CellKind::Keyframes => keys::cell_keyframe(map, cell, None),
        }
    }

    /// The kind of query that a map answers alike.
    pub(crate) fn of_map(self) -> Kind {
        match self {
            CellKind::Match => Kind::Match,
            CellKind::Localize => Kind::Localize,
            CellKind::Keyframes => Kind::Keyframes,
        }
    }
}

/// What is asked, and of what.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Subject {
    Map(Kind),
    Cell(CellKind, CellId),
}

impl Subject {
    pub(crate) fn kind(self) -> Kind {
        match self {
            Subject::Map(kind) => kind,
            Subject::Cell(kind, _) => kind.of_map(),
        }
    }

    /// The cell that is asked.
    pub(crate) fn cell(self) -> Option<CellId> {
        match self {
            Subject::Map(_) => None,
            Subject::Cell(_, cell) => Some(cell),
        }
    }

    /// The key of the replies; of keyframes each reply has its own.
    pub(crate) fn key(self, map: &str) -> Result<String, NameError> {
        match self {
            Subject::Map(kind) => kind.key(map),
            Subject::Cell(kind, cell) => kind.key(map, cell),
        }
    }
}
