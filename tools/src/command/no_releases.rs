//! In place of the commands of releases, in a build without them.

use super::left_out;

pub use super::left_out::Args as ListArgs;
pub use super::left_out::Args as DiffArgs;
pub use super::left_out::Args as RollbackArgs;
pub use super::left_out::Args as CleanArgs;
pub use super::left_out::Args as KeyArgs;

pub use refuse as list;
pub use refuse as diff;
pub use refuse as roll_back;
pub use refuse as clean;
pub use refuse as generate_key;

/// Refuses a command.
///
/// # Errors
/// Always, naming the feature.
pub fn refuse(_: &left_out::Args) -> anyhow::Result<()> {
    left_out::refuse("releases")
}
