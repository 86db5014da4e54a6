//! Whether a program does its work.

use serde::Serialize;

/// Whether a program does its work, and why or why not.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Health {
    /// Whether it does.
    pub is_well: bool,
    /// The reason, for an operator.
    pub reason: String,
}

impl Health {
    /// It does its work.
    pub fn well(reason: impl Into<String>) -> Self {
        Self { is_well: true, reason: reason.into() }
    }

    /// It does not.
    pub fn unwell(reason: impl Into<String>) -> Self {
        Self { is_well: false, reason: reason.into() }
    }
}
