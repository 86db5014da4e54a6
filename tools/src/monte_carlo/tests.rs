//! Laws of the Monte-Carlo runs.
